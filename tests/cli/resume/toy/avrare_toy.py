"""A plugin for the tests: a random walk that can be slow, or take its worker with it."""

import multiprocessing
import os
import time
from pathlib import Path

import numpy as np
from pydantic import Field

from avrare.plugin import Component, Options, hookimpl


class WalkConfig(Options):
    dt: float = Field(1.0, gt=0.0, description="step [s]")
    scale: float = Field(0.1, description="of a step")


class WalkSimulator:
    noise_size = 1

    def __init__(self, config):
        self.config, self.dt = config, config.dt

    def reset(self, noise):
        return {"x": np.zeros(len(noise))}

    def step(self, world, action, noise):
        # What no scenario says: a pause of every batch [s], a change of the code, a worker that is killed.
        if pause := os.environ.get("AVRARE_TOY_PAUSE"):
            time.sleep(float(pause))
        later = 1e-3 if os.environ.get("AVRARE_TOY_BUG") else 0.0
        path = os.environ.get("AVRARE_TOY_DIE")
        if path and multiprocessing.parent_process() and _first(Path(path)):
            os._exit(9)
        return {"x": world["x"] + self.config.scale * noise[:, 0] + later}

    def signals(self, world):
        return {"x": world["x"]}


def _first(path):
    """Remove a file; return whether it was there."""
    try:
        path.unlink()
    except FileNotFoundError:
        return False
    return True


def build(config, scene):
    return WalkSimulator(config)


@hookimpl
def avrare_components():
    return [Component("simulator", "toy_walk", "avrare_toy:WalkConfig", "avrare_toy:build", "a random walk")]
