"""Small simulators, and runs of them."""

import numpy as np

from avrare.base.batch import leaves
from avrare_highway_env.config import HighwayEnvConfig
from avrare_highway_env.simulator import HighwayEnvSimulator

LIDAR = {"cells": 24, "noise_variance": 0.004}
OPTIONS = {
    "merge": {"scene": "merge", "lidar": LIDAR, "traffic": {"acceleration_sd": 1.0}},
    "highway": {"scene": "highway", "vehicles": 5, "lidar": LIDAR},
    "roundabout": {"scene": "roundabout", "traffic": {"acceleration_sd": 1.0}},
    "intersection": {"scene": "intersection", "vehicles": 4, "lidar": LIDAR, "substeps": 2},
}


def simulator(**options):
    return HighwayEnvSimulator(HighwayEnvConfig.model_validate(options))


def tape(sim, n, steps, seed=0):
    return np.random.default_rng(seed).standard_normal((n, steps + 1, sim.noise_size))


def steering(t, n):
    """Return actions that differ from row to row and step to step."""
    rows = np.arange(n)
    return np.stack([0.3 * np.sin(0.7 * t + rows), 0.004 * np.cos(0.3 * t + rows)], axis=1)


def run(sim, noise, actions=steering, world=None, start=0):
    """Return all worlds from the start, or from ``world`` at step ``start``."""
    worlds = [sim.reset(noise[:, 0]) if world is None else world]
    for t in range(start + 1, noise.shape[1]):
        worlds.append(sim.step(worlds[-1], actions(t, len(noise)), noise[:, t]))
    return worlds


def numbers(world):
    return [leaf for leaf in leaves(world) if leaf.dtype != object]


def same(a, b):
    return all(np.array_equal(p, q) for p, q in zip(numbers(a), numbers(b), strict=True))
