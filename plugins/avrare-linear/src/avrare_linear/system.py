"""Linear system with Gaussian noise, observer and feedback (stl-ess, Eq. 8-10).

    x[t+1] = A x[t] + B u[t] + w[t]           u[t] = feedforward - K (z[t] - reference)
    y[t]   = C x[t] + v[t]                    z[t+1] = A z[t] + B u[t] + L (y[t] - C z[t])

z is the observer's estimate, or x itself without an observer. Row 0 of the noise tape gives x[0] and v[0],
row t gives w[t-1] and v[t]. Vectors are tuples of columns (N,), and products are explicit sums of them: no
row depends on its neighbours, and zeros cost nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from avrare.base.errors import UsageError
from avrare.protocols import Floats, System
from avrare.rollout.request import Integers
from avrare_linear.gains import kalman, regulator

Columns = tuple[Floats, ...]


@dataclass(frozen=True)
class LinearState:
    """State of N particles.

    Attributes:
        step: (N,) step t.
        x: n columns (N,), the state.
        estimate: n columns (N,), the observer's estimate; empty without an observer.
        output: q columns (N,), the measurement y.
    """

    step: Integers
    x: Columns
    estimate: Columns
    output: Columns


@dataclass(eq=False)
class LinearSystem(System):
    """Linear system ; ``LinearSystem.of`` makes one from plain matrices.

    Attributes are stacks with a leading axis of steps, the last entry of which holds for all later steps.

    Attributes:
        names: Names of the states, of the inputs and of the outputs.
        A: (S, n, n).
        B: (S, n, m).
        C: (S, q, n).
        process: (S, n, n) factor of w's covariance.
        measurement: (S, q, q) factor of v's covariance.
        mean: (1, n) expected state at t = 0.
        spread: (1, n, n) factor of its covariance.
        gain: K (S, m, n).
        observer: L (S, n, q), or None.
        reference: (S, n).
        feedforward: (S, m).
        noise_size: n + q.
        noise_names: Names of the noise numbers.
    """

    names: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]
    A: Floats
    B: Floats
    C: Floats
    process: Floats
    measurement: Floats
    mean: Floats
    spread: Floats
    gain: Floats
    observer: Floats | None
    reference: Floats
    feedforward: Floats
    noise_size: int = field(init=False)
    noise_names: tuple[str, ...] = field(init=False)

    @staticmethod
    def of(
        states: Sequence[str],
        A: ArrayLike,
        mean: ArrayLike,
        *,
        covariance: ArrayLike | None = None,
        inputs: Sequence[str] = (),
        B: ArrayLike | None = None,
        outputs: Sequence[str] = (),
        C: ArrayLike | None = None,
        process_noise: ArrayLike | None = None,
        measurement_noise: ArrayLike | None = None,
        gain: ArrayLike | None = None,
        costs: tuple[ArrayLike, ArrayLike] | None = None,
        observer: ArrayLike | bool = False,
        reference: ArrayLike | None = None,
        feedforward: ArrayLike | None = None,
    ) -> LinearSystem:
        """Make a system from matrices, or lists of them, one per step.

        Args:
            states: Names of the states.
            A: (n, n) or (S, n, n).
            mean: (n,) expected state at t = 0.
            covariance: (n, n) covariance of that state; None: zero.
            inputs: Names of the inputs.
            B: (n, m) or (S, n, m).
            outputs: Names of the outputs.
            C: (q, n) or (S, q, n).
            process_noise: Covariance of w, (n, n) or (S, n, n); None: none.
            measurement_noise: Covariance of v, (q, q) or (S, q, q); None: none.
            gain: K (m, n) or (S, m, n); None: see ``costs``.
            costs: Q (n, n) and R (m, m), for the optimal gain; None: no feedback.
            observer: L (n, q) or (S, n, q); True: the Kalman gain; False: the feedback uses the true state.
            reference: (n,) or (S, n); None: 0.
            feedforward: (m,) or (S, m); None: 0.

        Raises:
            UsageError: A shape is wrong, a covariance is invalid, or an optimal gain does not exist.
        """
        n, m, q = len(states), len(inputs), len(outputs)
        a, b, c = _stack("A", A, n, n), _stack("B", B, n, m), _stack("C", C, q, n)
        w, v = (
            _stack("process_noise", process_noise, n, n),
            _stack("measurement_noise", measurement_noise, q, q),
        )
        x0, start = _stack("mean", mean, n), _stack("covariance", covariance, n, n)[:1]
        factors = _factor("process_noise", w), _factor("measurement_noise", v)
        k = _stack("gain", gain, m, n)
        if costs is not None:
            k = regulator(
                a, b, _stack("state_cost", costs[0], n, n)[0], _stack("input_cost", costs[1], m, m)[0]
            )
        if isinstance(observer, bool):
            estimator = kalman(a, c, w, v, start[0]) if observer else None
        else:
            estimator = _stack("observer", observer, n, q)
        names = tuple(states), tuple(inputs), tuple(outputs)
        goal = _stack("reference", reference, n), _stack("feedforward", feedforward, m)
        spread = _factor("covariance", start)
        return LinearSystem(names, a, b, c, *factors, x0, spread, k, estimator, *goal)

    def __post_init__(self) -> None:
        self.noise_size = len(self.names[0]) + len(self.names[2])
        self.noise_names = (
            *(f"process noise of {name}" for name in self.names[0]),
            *(f"measurement noise of {name}" for name in self.names[2]),
        )
        factors = ("A", "B", "C", "process", "measurement", "spread", "gain", "observer")
        self._used = {name: _pattern(getattr(self, name)) for name in factors}

    def initial(self, noise: Floats) -> LinearState:
        """Return the state at t = 0."""
        step = np.zeros(len(noise), dtype=np.int64)
        n = len(self.names[0])
        mean = _vector(self.mean, step)
        x = _add(mean, self._times("spread", step, _columns(noise[:, :n])))
        estimate = mean if self.observer is not None else ()
        return LinearState(step, x, estimate, self._output(step, x, noise[:, n:]))

    def step(self, state: LinearState, noise: Floats) -> LinearState:
        """Return the state one step later."""
        step, n = state.step, len(self.names[0])
        push = self._times("B", step, self._input(state))
        drift = _add(self._times("A", step, state.x), push)
        x = _add(drift, self._times("process", step, _columns(noise[:, :n])))
        estimate: Columns = ()
        if self.observer is not None:
            innovation = _subtract(state.output, self._times("C", step, state.estimate))
            estimate = _add(self._times("A", step, state.estimate), push)
            estimate = _add(estimate, self._times("observer", step, innovation))
        return LinearState(step + 1, x, estimate, self._output(step + 1, x, noise[:, n:]))

    def signals(self, state: LinearState) -> dict[str, Floats]:
        """Return states, their ``*_estimate`` if there is an observer, inputs and outputs, (N,) each."""
        states, inputs, outputs = self.names
        estimates = [f"{name}_estimate" for name in states] if self.observer is not None else []
        signals = dict(zip(states, state.x, strict=True))
        signals |= zip(estimates, state.estimate, strict=True)
        signals |= zip(inputs, self._input(state), strict=True)
        return signals | dict(zip(outputs, state.output, strict=True))

    def _input(self, state: LinearState) -> Columns:
        measured = state.estimate if self.observer is not None else state.x
        error = _subtract(measured, _vector(self.reference, state.step))
        return _subtract(_vector(self.feedforward, state.step), self._times("gain", state.step, error))

    def _output(self, step: Integers, x: Columns, noise: Floats) -> Columns:
        return _add(self._times("C", step, x), self._times("measurement", step, _columns(noise)))

    def _times(self, name: str, step: Integers, vector: Columns) -> Columns:
        # Entries that are 0 at all steps are skipped.
        stack, rows = getattr(self, name), []
        for i, used in enumerate(self._used[name]):
            terms = [_entry(stack, step, (i, j)) * vector[j] for j in used]
            rows.append(sum(terms[1:], start=terms[0]) if terms else np.zeros(len(step)))
        return tuple(rows)


def _pattern(stack: Floats | None) -> list[list[int]]:
    # For each row the columns that are not 0 at all steps.
    if stack is None:
        return []
    return [np.flatnonzero(row).tolist() for row in np.asarray(stack.any(axis=0))]


def _columns(noise: Floats) -> Columns:
    return tuple(np.ascontiguousarray(column) for column in noise.T)


def _entry(stack: Floats, step: Integers, place: tuple[int, ...]) -> Any:
    # A number, or (N,) if it varies with time.
    if len(stack) == 1:
        return stack[(0, *place)]
    return stack[(np.minimum(step, len(stack) - 1), *place)]


def _vector(stack: Floats, step: Integers) -> Columns:
    return tuple(np.zeros(len(step)) + _entry(stack, step, (i,)) for i in range(stack.shape[1]))


def _add(left: Columns, right: Columns) -> Columns:
    return tuple(a + b for a, b in zip(left, right, strict=True))


def _subtract(left: Columns, right: Columns) -> Columns:
    return tuple(a - b for a, b in zip(left, right, strict=True))


def _stack(name: str, value: ArrayLike | None, *shape: int) -> Floats:
    """Convert to a stack (S, *shape); None becomes zeros.

    Raises:
        UsageError: The shape is wrong.
    """
    if value is None:
        return np.zeros((1, *shape))
    array = np.asarray(value, dtype=np.float64)
    stack = array[None] if array.ndim == len(shape) else array
    if stack.shape[1:] != shape or not len(stack):
        expected = " x ".join(map(str, shape))
        raise UsageError(f"{name} must be {expected}, or a list of these, but its shape is {array.shape}")
    if not np.isfinite(stack).all():
        raise UsageError(f"{name} has entries that are not finite")
    return stack


def _factor(name: str, covariances: Floats) -> Floats:
    """Return symmetric square roots (S, n, n).

    Raises:
        UsageError: A matrix is not symmetric, or has a negative eigenvalue.
    """
    if not np.array_equal(covariances, covariances.swapaxes(1, 2)):
        raise UsageError(f"{name} must be symmetric")
    values, vectors = np.linalg.eigh(covariances)
    if (values < -1e-9 * np.abs(values).max(axis=1, initial=0.0)[:, None]).any():
        raise UsageError(f"{name} is not a covariance: it has a negative eigenvalue")
    diagonal = all(not np.any(c - np.diag(np.diag(c))) for c in covariances)
    if diagonal:  # keeps one number of the tape per coordinate
        return np.sqrt(covariances)
    roots = np.sqrt(np.clip(values, 0.0, None))
    return np.asarray(np.einsum("sij,sj,skj->sik", vectors, roots, vectors))
