"""Plain stacks: cruise control, and a held speed; a scenario's block ``aeb`` adds emergency braking."""

from __future__ import annotations

import numpy as np

from avrare.driving import Action, Prediction, Scene, Vehicles
from avrare.protocols import Controller, Floats
from avrare_reference_drivers.config import CruiseConfig, HoldConfig
from avrare_reference_drivers.drivers import following_distance
from avrare_reference_drivers.path import Path
from avrare_reference_drivers.surroundings import find_leader, find_situation, steer_in_lane


class Cruise(Controller):
    """Cruise control that keeps the distance of R157 5.2.3.3 to the vehicle ahead.

    Its memory is the set speed, NaN before the first step where it is that of the start.
    """

    horizon = 1

    def __init__(self, config: CruiseConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene

    def start(self, n: int) -> Floats:
        """Return the set speed of ``n`` particles."""
        speed = self._config.set_speed
        return np.full(n, np.nan if speed is None else speed)

    def alternatives(self) -> dict[str, Controller]:
        """Return one that brakes earlier and harder behind others."""
        config = self._config
        change = {"gap_gain": 2.0 * config.gap_gain, "braking": 2.0 * config.braking}
        return {"brakes earlier and harder": Cruise(config.model_copy(update=change), self._scene)}

    def act(self, memory: Floats, ego: Vehicles, prediction: Prediction | None) -> tuple[Action, Floats]:
        """Return the lower acceleration of set speed and distance."""
        config, scene, set_speed = self._config, self._scene, np.where(np.isnan(memory), ego.speed, memory)
        gap, speed, exists = find_leader(find_situation("cruise", scene, ego, prediction), config.margin)
        free = config.speed_gain * (set_speed - ego.speed)
        room = gap - following_distance(ego.speed)
        behind = config.gap_gain * room + config.speed_gain * (speed - ego.speed)
        acceleration = np.where(exists, np.minimum(free, behind), free)
        acceleration = np.clip(acceleration, -config.braking, config.acceleration)
        turn = steer_in_lane(scene.road, ego, config.y_goal)
        return Action(np.maximum(acceleration, -ego.speed / scene.dt), turn), set_speed


class Hold(Controller):
    """Controller that holds a speed along a path or a lane, whoever is in the way; no memory."""

    horizon = 0

    def __init__(self, config: HoldConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene
        self._path = Path(config.path) if config.path else None

    def start(self, n: int) -> None:
        """Return no memory."""
        return

    def act(self, memory: None, ego: Vehicles, prediction: Prediction | None) -> tuple[Action, None]:
        """Return the acceleration towards the speed."""
        config = self._config
        wanted = np.zeros_like(ego.speed)
        if config.speed is not None:
            change = (config.speed - ego.speed) / self._scene.dt
            wanted = np.clip(change, -config.acceleration, config.acceleration)
        if self._path is not None:
            turn = self._path.steer(ego, config.lookahead)
        else:
            turn = steer_in_lane(self._scene.road, ego, config.y_goal)
        return Action(wanted, turn), None


def build_cruise(config: CruiseConfig, scene: Scene) -> Cruise:
    """Build the controller of a scenario."""
    return Cruise(config, scene)


def build_hold(config: HoldConfig, scene: Scene) -> Hold:
    """Build the controller of a scenario."""
    return Hold(config, scene)
