"""A plugin for the tests: a gust of wind against a driver's skill, with exact probabilities."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from avrare.plugin import Component, Options, hookimpl


class SimulatorConfig(Options):
    dt: float = Field(0.1, gt=0, description="step [s]")
    wind: float = Field(1.0, gt=0, description="strength of the gusts")
    breaks: float = Field(9.0, description="gust below minus this breaks the simulator down")


class DriverConfig(Options):
    skill: float = Field(1.0, gt=0, description="gusts are divided by it")


@dataclass(frozen=True)
class World:
    offset: np.ndarray
    broken: np.ndarray
    ego: None = None


class Simulator:
    noise_size = 1
    scene = None

    def __init__(self, config):
        self.config, self.dt = config, config.dt

    def reset(self, noise):
        return World(np.zeros(len(noise)), np.zeros(len(noise), dtype=bool))

    def step(self, world, action, noise):
        skill = 1.0 if action is None else action
        gust = self.config.wind * noise[:, 0]
        return World(gust / skill, world.broken | (gust < -self.config.breaks))

    def signals(self, world):
        return {"offset": world.offset}

    def faults(self, world):
        return world.broken


class Driver:
    horizon = 0

    def __init__(self, config):
        self.skill = config.skill

    def start(self, n):
        return np.zeros(n)

    def act(self, memory, ego, prediction):
        return self.skill, memory


def simulator(config, scene):
    return Simulator(config)


def driver(config, scene):
    return Driver(config)


@hookimpl
def avrare_components():
    return [
        Component("simulator", "gusts", "avrare_gusts:SimulatorConfig", "avrare_gusts:simulator", "wind"),
        Component("controller", "driver", "avrare_gusts:DriverConfig", "avrare_gusts:driver", "steers"),
    ]
