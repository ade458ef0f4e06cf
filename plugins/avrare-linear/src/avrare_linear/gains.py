"""Optimal gains: linear-quadratic regulator, and Kalman filter in its one-step predictor form.

Matrices are stacks with a leading axis of steps; the last one holds for all later steps. If all are constant,
the gain is the stationary one; otherwise the Riccati recursion gives one per step.
"""

from __future__ import annotations

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats


def _at(stack: Floats, step: int) -> Floats:
    return np.asarray(stack[min(step, len(stack) - 1)])


def regulator(A: Floats, B: Floats, state_cost: Floats, input_cost: Floats) -> Floats:
    """Return the gain K (S, m, n) of u = -K x that minimises the sum of x'Qx + u'Ru.

    Args:
        A: (S, n, n).
        B: (S, n, m).
        state_cost: Q (n, n).
        input_cost: R (m, m).

    Raises:
        UsageError: The gain does not exist: the pair (A, B) is not stabilisable, or R is not positive.
    """
    steps = max(len(A), len(B))
    if steps == 1:
        cost = _riccati(
            A[0], B[0], state_cost, input_cost, "feedback", "the inputs reach every unstable state"
        )
        return _regulator_gain(A[0], B[0], cost, input_cost)[None]
    # Riccati recursion, backwards from the last step.
    cost, gains = state_cost, []
    for step in reversed(range(steps)):
        a, b = _at(A, step), _at(B, step)
        gain = _regulator_gain(a, b, cost, input_cost)
        cost = state_cost + a.T @ cost @ (a - b @ gain)
        gains.append(gain)
    return np.stack(gains[::-1])


def kalman(A: Floats, C: Floats, process: Floats, measurement: Floats, initial: Floats) -> Floats:
    """Return the gain L (S, n, q) of the one-step prediction A x + B u + L (y - C x).

    Args:
        A: (S, n, n).
        C: (S, q, n).
        process: (S, n, n) covariance of w.
        measurement: (S, q, q) covariance of v.
        initial: (n, n) covariance of the state at t = 0; used if a matrix varies with time.

    Raises:
        UsageError: The gain does not exist: the pair (A, C) is not detectable, or an output has no noise.
    """
    steps = max(map(len, (A, C, process, measurement)))
    if steps == 1:
        spread = _riccati(
            A[0].T, C[0].T, process[0], measurement[0], "observer", "the outputs see every unstable state"
        )
        return _regulator_gain(A[0].T, C[0].T, spread, measurement[0]).T[None]
    # Riccati recursion, forwards from the initial covariance.
    spread, gains = initial, []
    for step in range(steps):
        a, c = _at(A, step), _at(C, step)
        gain = _regulator_gain(a.T, c.T, spread, _at(measurement, step)).T
        spread = _at(process, step) + a @ spread @ (a - gain @ c).T
        gains.append(gain)
    return np.stack(gains)


def _regulator_gain(a: Floats, b: Floats, cost: Floats, input_cost: Floats) -> Floats:
    try:
        return np.asarray(np.linalg.solve(input_cost + b.T @ cost @ b, b.T @ cost @ a), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise UsageError(f"no optimal gain exists: {error}", "make input_cost positive") from error


def _riccati(a: Floats, b: Floats, q: Floats, r: Floats, name: str, needed: str) -> Floats:
    from scipy.linalg import solve_discrete_are

    try:
        return np.asarray(solve_discrete_are(a, b, q, r))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise UsageError(f"{name}: no optimal gain exists: {error}", f"make sure that {needed}") from error
