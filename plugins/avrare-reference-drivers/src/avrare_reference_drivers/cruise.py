"""Plain stacks for longitudinal scenes: cruise control, and a held speed; both with emergency braking."""

from __future__ import annotations

import math

import numpy as np

from avrare.driving import Action, Prediction, Scene, Vehicles
from avrare.protocols import Controller, Floats
from avrare_reference_drivers.config import CruiseConfig, EmergencyConfig, HoldConfig
from avrare_reference_drivers.drivers import Driver, Reaction, Situation, following_distance
from avrare_reference_drivers.path import Path
from avrare_reference_drivers.surroundings import find_leader, find_situation, steer_in_lane


def build_emergency(config: EmergencyConfig) -> Driver:
    """Return emergency braking as a driver."""

    def demand(seen: Situation) -> Floats:
        near = (seen.ahead >= 0.0) & (seen.side_gap < config.margin) & (seen.closing > 0.0)
        return np.where(near & (seen.gap < config.ttc * seen.closing), config.braking, 0.0)

    jerk = config.braking / config.ramp if config.ramp else math.inf
    return Driver(demand, delay=config.delay, braking=config.braking, jerk=jerk)


class Cruise(Controller):
    """Cruise control that keeps the distance of R157 5.2.3.3 to the vehicle ahead."""

    horizon = 1

    def __init__(self, config: CruiseConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene
        self._emergency = _Emergency(config.emergency)

    def start(self, n: int) -> Reaction | None:
        """Return the memory of the emergency braking of ``n`` particles."""
        return self._emergency.start(n)

    def act(
        self, memory: Reaction | None, ego: Vehicles, prediction: Prediction | None
    ) -> tuple[Action, Reaction | None]:
        """Return the lowest acceleration of set speed, distance and emergency, and the memory."""
        config, scene = self._config, self._scene
        seen = find_situation("cruise", scene, ego, prediction)
        gap, speed, exists = find_leader(seen, config.margin)
        free = config.speed_gain * (config.set_speed - ego.speed)
        behind = config.gap_gain * (gap - following_distance(ego.speed)) + config.speed_gain * (
            speed - ego.speed
        )
        wanted = np.where(exists, np.minimum(free, behind), free)
        wanted = np.clip(wanted, -config.braking, config.acceleration)
        acceleration, later = self._emergency.override(memory, wanted, seen, ego, scene.dt)
        return Action(acceleration, steer_in_lane(scene.road, ego, config.y_goal)), later


class Hold(Controller):
    """Controller that holds a speed along a path or a lane."""

    horizon = 1

    def __init__(self, config: HoldConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene
        self._emergency = _Emergency(config.emergency)
        self._path = Path(config.path) if config.path else None

    def start(self, n: int) -> Reaction | None:
        """Return the memory of the emergency braking of ``n`` particles."""
        return self._emergency.start(n)

    def act(
        self, memory: Reaction | None, ego: Vehicles, prediction: Prediction | None
    ) -> tuple[Action, Reaction | None]:
        """Return the acceleration towards the speed, or the emergency's, and the memory."""
        config, scene = self._config, self._scene
        wanted = np.zeros_like(ego.speed)
        if config.speed is not None:
            change = (config.speed - ego.speed) / scene.dt
            wanted = np.clip(change, -config.acceleration, config.acceleration)
        if config.emergency is None:
            acceleration, later = wanted, memory
        else:
            seen = find_situation("hold", scene, ego, prediction)
            acceleration, later = self._emergency.override(memory, wanted, seen, ego, scene.dt)
        if self._path is not None:
            turn = self._path.steer(ego, config.lookahead)
        else:
            turn = steer_in_lane(scene.road, ego, config.y_goal)
        return Action(acceleration, turn), later


class _Emergency:
    def __init__(self, config: EmergencyConfig | None) -> None:
        self._driver = None if config is None else build_emergency(config)

    def start(self, n: int) -> Reaction | None:
        return None if self._driver is None else Reaction.start(self._driver, n)

    def override(
        self, memory: Reaction | None, wanted: Floats, seen: Situation, ego: Vehicles, dt: float
    ) -> tuple[Floats, Reaction | None]:
        later = memory
        if self._driver is not None and memory is not None:
            demand = self._driver.demand(seen).max(axis=1, initial=0.0)
            braking, later = memory.advance(self._driver, demand, dt)
            wanted = np.where(braking > 0.0, np.minimum(wanted, -braking), wanted)
        return np.maximum(wanted, -ego.speed / dt), later


def build_cruise(config: CruiseConfig, scene: Scene) -> Cruise:
    """Build the controller of a scenario."""
    return Cruise(config, scene)


def build_hold(config: HoldConfig, scene: Scene) -> Hold:
    """Build the controller of a scenario."""
    return Hold(config, scene)
