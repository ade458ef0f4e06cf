"""Nominal flight, shipped as arrays; ``benchmarks/glider_nominal_flight.py`` makes it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from avrare.protocols import Floats


@dataclass(frozen=True)
class Flight:
    """Flight without noise on the time grid of the simulator.

    Attributes:
        states: (K + 1, 7) at t = 0, dt, ..., K dt; columns as in ``aircraft.NAMES``.
        inputs: (K,) rate of the elevator over each step [rad/s].
    """

    states: Floats
    inputs: Floats


@cache
def nominal() -> Flight:
    """Return the shipped flight: 66 steps, from ``aircraft.START`` to the wire."""
    shipped = files("avrare_glider") / "nominal.npz"
    with shipped.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        return Flight(arrays["states"], arrays["inputs"])
