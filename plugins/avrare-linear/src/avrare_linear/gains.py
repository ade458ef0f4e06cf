"""Optimal gains: the regulator of a quadratic cost, and the Kalman filter in its predicting form.

Matrices are stacks with a leading axis of steps; the last one holds from there on. Where all are constant the
gain is the stationary one, else Riccati's recursion gives one a step.
"""

from __future__ import annotations

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats


def at(stack: Floats, step: int) -> Floats:
    """The entry of a stack for a step."""
    return np.asarray(stack[min(step, len(stack) - 1)])


def regulator(A: Floats, B: Floats, state_cost: Floats, input_cost: Floats) -> Floats:
    """Gain K (S, m, n) of u = -K x that minimises the sum of x'Qx + u'Ru.

    Args:
        A: (S, n, n).
        B: (S, n, m).
        state_cost: Q (n, n).
        input_cost: R (m, m).

    Raises:
        UsageError: There is no such gain: the pair (A, B) cannot be stabilised, or R is not positive.
    """
    steps = max(len(A), len(B))
    if steps == 1:
        cost = _riccati(
            A[0], B[0], state_cost, input_cost, "feedback", "the inputs reach every unstable state"
        )
        return _regulator_gain(A[0], B[0], cost, input_cost)[None]
    cost, gains = state_cost, []
    for step in reversed(range(steps)):
        a, b = at(A, step), at(B, step)
        gain = _regulator_gain(a, b, cost, input_cost)
        cost = state_cost + a.T @ cost @ (a - b @ gain)
        gains.append(gain)
    return np.stack(gains[::-1])


def kalman(A: Floats, C: Floats, process: Floats, measurement: Floats, initial: Floats) -> Floats:
    """Gain L (S, n, q) of the estimate one step ahead, A x + B u + L (y - C x).

    Args:
        A: (S, n, n).
        C: (S, q, n).
        process: (S, n, n) covariance of w.
        measurement: (S, q, q) covariance of v.
        initial: (n, n) covariance of the state at t = 0; used where something changes with time.

    Raises:
        UsageError: There is no such gain: the pair (A, C) cannot be detected, or v has no noise in an output.
    """
    steps = max(map(len, (A, C, process, measurement)))
    if steps == 1:
        spread = _riccati(
            A[0].T, C[0].T, process[0], measurement[0], "observer", "the outputs see every unstable state"
        )
        return _regulator_gain(A[0].T, C[0].T, spread, measurement[0]).T[None]
    spread, gains = initial, []
    for step in range(steps):
        a, c = at(A, step), at(C, step)
        gain = _regulator_gain(a.T, c.T, spread, at(measurement, step)).T
        spread = at(process, step) + a @ spread @ (a - gain @ c).T
        gains.append(gain)
    return np.stack(gains)


def _regulator_gain(a: Floats, b: Floats, cost: Floats, input_cost: Floats) -> Floats:
    try:
        return np.asarray(np.linalg.solve(input_cost + b.T @ cost @ b, b.T @ cost @ a), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise UsageError(f"there is no optimal gain: {error}", "make input_cost positive") from error


def _riccati(a: Floats, b: Floats, q: Floats, r: Floats, name: str, needed: str) -> Floats:
    from scipy.linalg import solve_discrete_are

    try:
        return np.asarray(solve_discrete_are(a, b, q, r))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise UsageError(f"{name}: there is no optimal gain: {error}", f"make sure that {needed}") from error
