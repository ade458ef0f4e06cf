"""The perching glider of the avrare-glider plugin, whose equations of motion are NumPy alone."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibration.problems.problem import Floats

_PLUGIN = Path(__file__).parents[3] / "plugins" / "avrare-glider" / "src" / "avrare_glider"
_REACH = 0.05
"""Distance |x| + |z| [m] to the wire that must be reached."""


def _aircraft() -> Any:
    """Return the plugin's module of that name without its package, which needs avrare."""
    spec = importlib.util.spec_from_file_location("calibration_aircraft", _PLUGIN / "aircraft.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Perching:
    """A glider flies the planned elevator without feedback, disturbed; fails if it never is at the wire.

    State: the aircraft's seven columns, time, least distance.

    Args:
        actuator: Standard deviation of the elevator's rate [rad/s].
    """

    noise_size = 1

    def __init__(self, actuator: float) -> None:
        self.actuator, self.aircraft = actuator, _aircraft()
        with np.load(_PLUGIN / "nominal.npz") as flight:
            self.inputs, self.reference = flight["inputs"], flight["states"]
        self.steps = len(self.inputs)
        self.start = (*self.aircraft.START, 0.0, np.inf)
        self.formula = f"eventually[0:{self.steps}] (abs(x) + abs(z) <= {_REACH})"

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Move once; the elevator's servo and stops have limits."""
        columns, limit = tuple(state[:, :7].T), self.aircraft.RATE_LIMIT
        inputs = self.inputs[state[:, 7].astype(np.int64)]
        rate = np.clip(inputs + self.actuator * noise[:, 0], -limit, limit)
        room = [(stop - columns[3]) / self.aircraft.DT for stop in self.aircraft.ELEVATOR_STOPS]
        moved = self.aircraft.advance(columns, np.clip(rate, *room))
        distance = np.abs(moved[0]) + np.abs(moved[1])
        return np.stack([*moved, state[:, 7] + 1.0, np.minimum(state[:, 8], distance)], axis=1)

    def margin(self, state: Floats) -> Floats:
        """Return how far inside the distance it came (N,), known at the end alone."""
        return np.where(state[:, 7] < self.steps, np.inf, _REACH - state[:, 8])

    def score(self, state: Floats) -> Floats:
        """Return how far the glider is off its plan, over the distance; 1 at failure alone (N,)."""
        plan = self.reference[state[:, 7].astype(np.int64), :2]
        off = np.abs(state[:, :2] - plan).sum(axis=1) / _REACH
        return np.where(self.margin(state) <= 0.0, 1.0, np.minimum(off, 0.999))

    def signals(self, state: Floats) -> dict[str, Floats]:
        """Return ``x`` and ``z`` (N,)."""
        return {"x": state[:, 0], "z": state[:, 1]}
