"""Options of the simulator ``linear``. Units are those of the states, which the user chooses."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from avrare.plugin import Options

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]


def _convert_to_tuples(value: object) -> object:
    # Strict validation refuses lists.
    return tuple(map(_entry, value)) if isinstance(value, list | tuple) else value


def _entry(value: object) -> object:
    # Checked here, as the wrapping below would hide the place of an entry.
    if isinstance(value, bool) or not isinstance(value, int | float | list | tuple):
        raise ValueError(f"{value!r} is not a number")
    return _convert_to_tuples(value)


def _depth(value: object) -> int:
    # 1 for a vector, 2 for a matrix, 3 for a matrix per step.
    return 1 + _depth(value[0]) if isinstance(value, list | tuple) and value else 0


def _stack(depth: int) -> Callable[[Any], Any]:
    # One value for all steps, of the given depth, becomes a list of one.
    return lambda value: _convert_to_tuples([value] if _depth(value) == depth else value)


def _covariances(value: Any) -> object:
    if _depth(value) != 1:
        return _stack(2)(value)
    value = _convert_to_tuples(value)
    return (tuple(tuple(x if i == j else 0.0 for j in range(len(value))) for i, x in enumerate(value)),)


Matrices = Annotated[tuple[Matrix, ...], BeforeValidator(_stack(2)), Field(min_length=1)]
Covariances = Annotated[tuple[Matrix, ...], BeforeValidator(_covariances), Field(min_length=1)]
Vectors = Annotated[tuple[Vector, ...], BeforeValidator(_stack(1)), Field(min_length=1)]


class InitialConfig(Options):
    """Distribution of the state at t = 0."""

    mean: Vector = Field(description="expected state, in the units of the states")
    covariance: Covariances | None = Field(
        default=None, description="matrix, or its diagonal; default: the state starts at the mean"
    )


class FeedbackConfig(Options):
    """Gain K of u = feedforward - K (estimate - reference): given, or optimal for a quadratic cost."""

    gain: Matrices | None = Field(default=None, description="K, inputs x states; or a list, one per step")
    state_cost: Covariances | None = Field(
        default=None, description="Q of the cost x'Qx + u'Ru, matrix or diagonal"
    )
    input_cost: Covariances | None = Field(default=None, description="R of the cost, matrix or diagonal")

    @model_validator(mode="after")
    def _check_choice(self) -> Self:
        costs = [cost is not None for cost in (self.state_cost, self.input_cost)]
        if all(costs) == (self.gain is not None) or any(costs) != all(costs):
            raise ValueError("give either gain, or state_cost and input_cost")
        return self


class ObserverConfig(Options):
    """Gain L of the estimate's correction L (y - C estimate); the Kalman gain if it is not given."""

    gain: Matrices | None = Field(
        default=None, description="L, states x outputs; or a list, one per step; default: the Kalman gain"
    )


class LinearConfig(Options):
    """Options of the simulator ``linear``: x' = A x + B u + w, y = C x + v.

    A matrix that varies with time is a list of matrices, one per step; the last one holds for all later
    steps. The same applies to the rows of ``reference`` and ``feedforward``.
    """

    dt: float = Field(default=1.0, gt=0.0, description="step [s]; formulas in seconds use it")
    states: tuple[str, ...] = Field(min_length=1, description="names of the states, which are signals")
    inputs: tuple[str, ...] = Field(default=(), description="names of the inputs, which are signals")
    outputs: tuple[str, ...] = Field(default=(), description="names of the measurements, which are signals")
    A: Matrices = Field(description="states x states; or a list, one per step")
    B: Matrices | None = Field(default=None, description="states x inputs; or a list, one per step")
    C: Matrices | None = Field(default=None, description="outputs x states; or a list, one per step")
    process_noise: Covariances | None = Field(
        default=None, description="covariance of w: matrix, diagonal, or a list of matrices; default: none"
    )
    measurement_noise: Covariances | None = Field(
        default=None, description="covariance of v: matrix, diagonal, or a list of matrices; default: none"
    )
    initial: InitialConfig = Field(description="the state at t = 0")
    reference: Vectors | None = Field(
        default=None, description="reference state: one, or a list, one per step; default: 0"
    )
    feedforward: Vectors | None = Field(
        default=None, description="input beside the feedback: one, or a list, one per step; default: 0"
    )
    feedback: FeedbackConfig | None = Field(default=None, description="controller; default: no feedback")
    observer: ObserverConfig | None = Field(
        default=None, description="estimator of the state; default: the feedback uses the true state"
    )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all signals: states, their estimates if there is an observer, inputs, outputs."""
        estimates = tuple(f"{name}_estimate" for name in self.states) if self.observer else ()
        return (*self.states, *estimates, *self.inputs, *self.outputs)

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        for name in self.names:
            if not re.fullmatch(r"[A-Za-z_]\w*", name):
                raise ValueError(f"{name!r} is not a valid signal name: use letters, digits and '_'")
        if len(set(self.names)) != len(self.names):
            raise ValueError("states, estimates, inputs and outputs need different names")
        return self

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if bool(self.inputs) != (self.B is not None):
            raise ValueError("give inputs and B together, or neither")
        if bool(self.outputs) != (self.C is not None):
            raise ValueError("give outputs and C together, or neither")
        for name in ("feedback", "feedforward"):
            if getattr(self, name) is not None and not self.inputs:
                raise ValueError(f"{name} needs inputs and B")
        if self.observer is not None and not self.outputs:
            raise ValueError("observer needs outputs and C")
        if self.measurement_noise is not None and not self.outputs:
            raise ValueError("measurement_noise needs outputs and C")
        return self

    @model_validator(mode="after")
    def _shapes(self) -> Self:
        n, m, q = len(self.states), len(self.inputs), len(self.outputs)
        _check_matrices("A", self.A, n, n, "states x states")
        _check_matrices("B", self.B, n, m, "states x inputs")
        _check_matrices("C", self.C, q, n, "outputs x states")
        _check_covariances("process_noise", self.process_noise, n, "states")
        _check_covariances("measurement_noise", self.measurement_noise, q, "outputs")
        _check_vectors("initial.mean", (self.initial.mean,), n, "states")
        _check_covariances("initial.covariance", self.initial.covariance, n, "states", most=1)
        _check_vectors("reference", self.reference, n, "states")
        _check_vectors("feedforward", self.feedforward, m, "inputs")
        if self.feedback is not None:
            _check_matrices("feedback.gain", self.feedback.gain, m, n, "inputs x states")
            _check_covariances("feedback.state_cost", self.feedback.state_cost, n, "states", most=1)
            _check_covariances("feedback.input_cost", self.feedback.input_cost, m, "inputs", most=1)
        if self.observer is not None:
            _check_matrices("observer.gain", self.observer.gain, n, q, "states x outputs")
        return self


def _check_matrices(
    name: str, matrices: tuple[Matrix, ...] | None, rows: int, columns: int, layout: str
) -> None:
    for matrix in matrices or ():
        widths = {len(row) for row in matrix}
        if len(matrix) != rows or widths != {columns}:
            size = f"{len(matrix)} x {widths.pop()}" if len(widths) == 1 else "rows of different lengths"
            raise ValueError(f"{name} must be {layout}, {rows} x {columns}, not {size}")


def _check_vectors(name: str, vectors: tuple[Vector, ...] | None, size: int, kind: str) -> None:
    for vector in vectors or ():
        if len(vector) != size:
            raise ValueError(f"{name} must have one number for each of the {size} {kind}, not {len(vector)}")


def _check_covariances(
    name: str, matrices: tuple[Matrix, ...] | None, size: int, kind: str, most: int | None = None
) -> None:
    _check_matrices(name, matrices, size, size, f"{kind} x {kind}")
    if most is not None and len(matrices or ()) > most:
        raise ValueError(f"{name} must be one matrix, or its diagonal")
    for matrix in matrices or ():
        for i in range(size):
            if any(matrix[i][j] != matrix[j][i] for j in range(i)):
                raise ValueError(f"{name} must be symmetric")
            if matrix[i][i] < 0.0:
                raise ValueError(f"{name} has a negative variance on its diagonal")
