"""Time-varying linear-quadratic feedback along a flight."""

from __future__ import annotations

import numpy as np

from avrare.protocols import Floats
from avrare_glider.aircraft import DT, NAMES, advance
from avrare_glider.config import FeedbackConfig
from avrare_glider.nominal import Flight


def linearise(flight: Flight) -> tuple[Floats, Floats]:
    """Linearise the step along a flight, by complex steps.

    Returns:
        A (K, 7, 7) and B (K, 7): error' = A error + B (change of the input).
    """
    size, k = len(NAMES), len(flight.inputs)
    turned = np.repeat(flight.states[:-1, None].astype(complex), size + 1, axis=1)  # (K, direction, column)
    # imaginary step: derivatives without cancellation, exact except for one or two bits
    imaginary_step = 1e-20
    turned[:, np.arange(size), np.arange(size)] += 1j * imaginary_step
    inputs = np.repeat(flight.inputs[:, None].astype(complex), size + 1, axis=1)
    inputs[:, size] += 1j * imaginary_step
    after = advance(tuple(turned.reshape(-1, size).T), inputs.reshape(-1))
    slopes = np.stack(after, axis=-1).imag.reshape(k, size + 1, size) / imaginary_step
    return slopes[:, :size].swapaxes(1, 2), slopes[:, size]


def gains(flight: Flight, cost: FeedbackConfig) -> Floats:
    """Return the optimal gains by the Riccati recursion, backwards from the end.

    Returns:
        (K, 7): the change of the input is minus gain times error.
    """
    a, b = linearise(flight)
    state, effort = np.diag(cost.state_cost) * DT, cost.input_cost * DT
    to_go, rows = np.diag(cost.final_cost), np.empty_like(b)
    for t in reversed(range(len(b))):
        rows[t] = (b[t] @ to_go @ a[t]) / (effort + b[t] @ to_go @ b[t])
        closed = a[t] - np.outer(b[t], rows[t])
        to_go = state + effort * np.outer(rows[t], rows[t]) + closed.T @ to_go @ closed
    return rows
