"""Vehicles: highway-env's drivers with moods, and an ego with fast prediction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle

from avrare.protocols import Floats

_PARAMETERS = (
    ("time_gap", "TIME_WANTED", 1.0),
    ("acceleration", "COMFORT_ACC_MAX", 1.0),
    ("deceleration", "COMFORT_ACC_MIN", -1.0),
)
"""Option, attribute of highway-env, and the sign that it has there."""


class MoodyDriver(IDMVehicle):  # type: ignore[misc]
    """Intelligent driver model and MOBIL lane changes, with an offset on the acceleration.

    Attributes:
        mood: Offset on the model's acceleration [m/s^2]; 0 gives highway-env's driver.
        tuned: Whether ``tune`` has set its parameters.
    """

    mood = 0.0
    tuned = False
    speed: float

    def tune(self, options: Mapping[str, float]) -> None:
        """Set the parameters that ``TrafficConfig`` names."""
        self.tuned = True
        if "desired_speed" in options:
            self.target_speed = options["desired_speed"]
        for name, attribute, sign in _PARAMETERS:
            if name in options:
                setattr(self, attribute, sign * options[name])

    def act(self, action: dict[str, object] | str | None = None) -> None:
        """Set the model's action, with the mood added to the acceleration within the model's bounds."""
        super().act(action)
        if self.mood and not self.crashed:
            acceleration = self.action["acceleration"] + self.mood
            self.action["acceleration"] = np.clip(acceleration, -self.ACC_MAX, self.ACC_MAX)

    def step(self, dt: float) -> None:
        """Advance by ``dt`` [s]; braking ends at standstill, where highway-env's drivers go on backwards."""
        self.action["acceleration"] = max(self.action["acceleration"], -self.speed / dt)
        super().step(dt)
        self.speed = max(self.speed, 0.0)


class IntersectionDriver(MoodyDriver):
    """Driver who slows down before a bend on its way.

    A separate class, since the intersection changes the model's parameters on the class.
    """

    def act(self, action: dict[str, object] | str | None = None) -> None:
        """Set the action: that of its model, or braking to the speed limit of the lane that follows."""
        super().act(action)
        lane, following = self.lane, self._find_next_lane()
        if self.crashed or following is None or following.speed_limit >= lane.speed_limit:
            return
        excess = self.speed**2 - following.speed_limit**2
        way = max(lane.length - lane.local_coordinates(self.position)[0], 0.5)
        bend_braking = 2.0  # deceleration at which a driver begins to brake for a bend [m/s^2]
        if excess > 2.0 * bend_braking * way:
            braking = max(-0.5 * excess / way, -self.ACC_MAX)
            self.action["acceleration"] = min(self.action["acceleration"], braking)

    def _find_next_lane(self) -> AbstractLane | None:
        _, end, _ = self.lane_index
        following = (index for index in self.route or () if index[0] == end)
        return next((self.road.network.get_lane((begin, end, 0)) for begin, end, _ in following), None)


class LightEgo(Vehicle):  # type: ignore[misc]
    """Ego of the intersection, of which the right-of-way rule predicts positions at low cost."""

    def predict_trajectory_constant_speed(self, times: Floats) -> tuple[list[Floats], list[float]]:
        """Return the positions and headings of highway-env without copying the road or searching lanes."""
        twin: Any = object.__new__(Vehicle)
        vars(twin).update(vars(self))
        twin.road, twin.position = None, self.position.copy()
        path: tuple[list[Floats], list[float]] = Vehicle.predict_trajectory_constant_speed(twin, times)
        return path
