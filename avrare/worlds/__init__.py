"""Bring your own simulator: worlds that each know one world at a time, as a simulator of N of them."""

from avrare.worlds.capabilities import Capabilities, capabilities, require
from avrare.worlds.channel import Channel
from avrare.worlds.noisy import Noisy
from avrare.worlds.simulator import Worlds, WorldState
from avrare.worlds.system import WorldSystem, as_system
from avrare.worlds.timeout import StepTimeout
from avrare.worlds.world import NotDeterministic, World

__all__ = [
    "Capabilities",
    "Channel",
    "Noisy",
    "NotDeterministic",
    "StepTimeout",
    "World",
    "WorldState",
    "WorldSystem",
    "Worlds",
    "as_system",
    "capabilities",
    "require",
]
