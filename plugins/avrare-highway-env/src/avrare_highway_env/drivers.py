"""The vehicles: drivers as highway-env has them plus a mood, and an ego that is quick to predict."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle


class MoodyDriver(IDMVehicle):  # type: ignore[misc]
    """Intelligent driver model and MOBIL lane changes, with an offset on the acceleration.

    Attributes:
        mood: Added to the model's acceleration [m/s^2]; 0 leaves highway-env's driver as it is.
    """

    mood = 0.0

    def act(self, action: dict[str, Any] | str | None = None) -> None:
        """The model's action with the mood on its acceleration, within the model's own bounds."""
        super().act(action)
        if self.mood and not self.crashed:
            wanted = self.action["acceleration"] + self.mood
            self.action["acceleration"] = np.clip(wanted, -self.ACC_MAX, self.ACC_MAX)


class IntersectionDriver(MoodyDriver):
    """A class of its own: the intersection changes the model's parameters on the class."""


class LightEgo(Vehicle):  # type: ignore[misc]
    """The ego of the intersection, whose right of way needs to know where the ego will be."""

    def predict_trajectory_constant_speed(self, times: Any) -> Any:
        """The same places and headings (tested), without copying the road and looking for lanes on it."""
        twin: Any = object.__new__(Vehicle)
        vars(twin).update(vars(self))
        twin.road, twin.position = None, self.position.copy()
        return Vehicle.predict_trajectory_constant_speed(twin, times)
