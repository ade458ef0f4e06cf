"""Controller that brakes as a reference driver does, and keeps its lane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from avrare.driving import Action, Prediction, Scene, Vehicles
from avrare.protocols import Controller, Floats
from avrare_reference_drivers.config import ReferenceDriverConfig
from avrare_reference_drivers.drivers import (
    DRIVERS,
    Reaction,
    Situation,
    following_distance,
    fsm_distance,
    rss_distance,
)
from avrare_reference_drivers.surroundings import find_leader, find_situation, steer_in_lane

_DISTANCES: dict[str, Callable[[Floats, Floats], Floats]] = {
    "cc": lambda speed, _: 2.0 * speed,
    "cc_lane": lambda speed, _: 2.0 * speed,
    "reg157": lambda speed, _: following_distance(speed),
    "rss": rss_distance,
    "fsm": fsm_distance,
}
"""Distance (N,) that each driver keeps at its own speed and that of the vehicle ahead."""


class ReferenceDriver(Controller):
    """Driver that keeps its speed until it sees a danger, brakes, and then keeps its distance.

    It never speeds up. Its delay is counted once in a rollout.
    """

    horizon = 1

    def __init__(self, config: ReferenceDriverConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene
        self._driver = DRIVERS[config.model]
        self._settles = config.model in ("cc", "cc_lane") and config.ttc_reading == "settled"
        self.sees_truth = config.sees == "truth"

    def start(self, n: int) -> Reaction:
        """Return the state of ``n`` drivers that have seen no danger."""
        return Reaction.start(self._driver, n)

    def act(self, memory: Reaction, ego: Vehicles, prediction: Prediction | None) -> tuple[Action, Reaction]:
        """Return the braking for the worst of the others, and the state after it."""
        situation = find_situation("reference_driver", self._scene, ego, prediction)
        demand = self._driver.demand(self._look_ahead(situation)).max(axis=1, initial=0.0)
        braking, later = memory.advance(self._driver, demand, self._scene.dt)
        follows = np.full(len(demand), self._settles) | (self._config.follows & (later.delay <= 0.0))
        braking = np.where(follows & (demand <= 0.0), self._close_up(situation, ego), braking)
        acceleration = np.maximum(-braking, -ego.speed / self._scene.dt)
        turn = steer_in_lane(self._scene.road, ego, self._config.y_goal)
        return Action(acceleration, turn), later

    def _look_ahead(self, seen: Situation) -> Situation:
        # JRC's stepping applies a speed from the begin of its step: half a step of braking more.
        lost = 0.5 * self._scene.dt * np.maximum(seen.closing, 0.0)
        return replace(seen, ahead=seen.ahead - lost, gap=seen.gap - lost)

    def _close_up(self, seen: Situation, ego: Vehicles) -> Floats:
        gap, speed, exists = find_leader(seen, margin=0.0)
        distance = _DISTANCES[self._config.model](ego.speed, speed)
        desired_speed = 2.0 * (speed - ego.speed) + gap - distance
        # the most [m/s^2] behind others without a danger
        return np.where(exists, np.clip(-desired_speed, 0.0, 4.0), 0.0)


def build(config: ReferenceDriverConfig, scene: Scene) -> ReferenceDriver:
    """Build the controller of a scenario."""
    return ReferenceDriver(config, scene)
