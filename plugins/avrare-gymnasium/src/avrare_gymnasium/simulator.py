"""A Gymnasium environment as the simulator of a scenario."""

from __future__ import annotations

import functools

from avrare.worlds.channel import Channel
from avrare.worlds.noisy import Noisy
from avrare.worlds.simulator import Worlds
from avrare.worlds.world import World
from avrare_gymnasium.config import GymnasiumConfig
from avrare_gymnasium.world import GymWorld, state_size


def build(config: GymnasiumConfig, scene: object | None = None) -> Worlds:
    """The simulator of a scenario.

    Raises:
        UsageError: There is no such environment, or an option does not fit it.
        PluginError: It needs a package that is not installed.
    """
    return Worlds(
        functools.partial(make_world, config), dt=config.dt, copy=config.copy_by,
        step_timeout=config.step_timeout, reuse=config.reuse,
    )  # fmt: skip


def make_world(config: GymnasiumConfig) -> World:
    """One environment with the noise of its scenario."""
    world, noise = GymWorld(config), config.noise
    shown = initial = None
    if noise.observation is not None:
        shown = Channel(len(world.seen), noise.observation.scale, noise.observation.law)
    if noise.initial is not None:
        size = state_size(world, noise.initial.attribute)
        initial = Channel(size, noise.initial.scale, noise.initial.law)
    if shown is None and initial is None:
        return world
    return Noisy(world, observation=shown, initial=initial)
