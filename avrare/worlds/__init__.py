"""Worlds: your own simulator, which advances one world at a time, as a batched simulator."""

from avrare.worlds.capabilities import Capabilities, capabilities, require
from avrare.worlds.noisy_world import Channel, Noisy
from avrare.worlds.step_timeout import StepTimeout
from avrare.worlds.world import NotDeterministic, World, WorldController
from avrare.worlds.worlds_simulator import Worlds, WorldState, WorldSystem, as_system

__all__ = [
    "Capabilities",
    "Channel",
    "Noisy",
    "NotDeterministic",
    "StepTimeout",
    "World",
    "WorldController",
    "WorldState",
    "WorldSystem",
    "Worlds",
    "as_system",
    "capabilities",
    "require",
]
