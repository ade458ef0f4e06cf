"""What a scenario says about a linear system. Units are those of the states, which the user chooses."""

from __future__ import annotations

import re
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]


def _tuples(value: Any) -> Any:
    """Lists as tuples: strict validation takes no lists from here on."""
    return tuple(map(_entry, value)) if isinstance(value, list | tuple) else value


def _entry(value: Any) -> Any:
    """What a list holds; complained of here, for the wrapping below would hide the place."""
    if isinstance(value, bool) or not isinstance(value, int | float | list | tuple):
        raise ValueError(f"{value!r} is not a number")
    return _tuples(value)


def _depth(value: Any) -> int:
    """How deeply lists are nested: 1 for a vector, 2 for a matrix, 3 for one matrix a step."""
    return 1 + _depth(value[0]) if isinstance(value, list | tuple) and value else 0


def _matrices(value: Any) -> Any:
    """One matrix for all steps becomes a list of one."""
    return _tuples([value] if _depth(value) == 2 else value)


def _covariances(value: Any) -> Any:
    """A vector is a diagonal."""
    if _depth(value) != 1:
        return _matrices(value)
    value = _tuples(value)
    return (tuple(tuple(x if i == j else 0.0 for j in range(len(value))) for i, x in enumerate(value)),)


def _vectors(value: Any) -> Any:
    """One vector for all steps becomes a list of one."""
    return _tuples([value] if _depth(value) == 1 else value)


Matrices = Annotated[tuple[Matrix, ...], BeforeValidator(_matrices), Field(min_length=1)]
Covariances = Annotated[tuple[Matrix, ...], BeforeValidator(_covariances), Field(min_length=1)]
Vectors = Annotated[tuple[Vector, ...], BeforeValidator(_vectors), Field(min_length=1)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class InitialConfig(_Model):
    """The law of the state at t = 0."""

    mean: Vector = Field(description="expected state, in the units of the states")
    covariance: Covariances | None = Field(
        default=None, description="matrix, or its diagonal; without: the state starts at the mean"
    )


class FeedbackConfig(_Model):
    """The gain K of u = feedforward - K (estimate - reference): given, or the optimum of a quadratic cost."""

    gain: Matrices | None = Field(default=None, description="K, inputs x states; or a list, one per step")
    state_cost: Covariances | None = Field(
        default=None, description="Q of the cost x'Qx + u'Ru, matrix or diagonal"
    )
    input_cost: Covariances | None = Field(default=None, description="R of the cost, matrix or diagonal")

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        costs = [cost is not None for cost in (self.state_cost, self.input_cost)]
        if all(costs) == (self.gain is not None) or any(costs) != all(costs):
            raise ValueError("give either gain, or state_cost and input_cost")
        return self


class ObserverConfig(_Model):
    """The gain L of the estimate's correction L (y - C estimate); Kalman's where it is not given."""

    gain: Matrices | None = Field(
        default=None, description="L, states x outputs; or a list, one per step; without: the Kalman gain"
    )


class LinearConfig(_Model):
    """Options of the simulator ``linear``: x' = A x + B u + w, y = C x + v.

    A matrix that changes with time is a list of matrices, one a step; the last one holds from there on. The
    same goes for the rows of ``reference`` and ``feedforward``.
    """

    dt: float = Field(default=1.0, gt=0.0, description="step [s]; formulas in seconds use it")
    states: tuple[str, ...] = Field(min_length=1, description="names of the states, which are signals")
    inputs: tuple[str, ...] = Field(default=(), description="names of the inputs, which are signals")
    outputs: tuple[str, ...] = Field(default=(), description="names of the measurements, which are signals")
    A: Matrices = Field(description="states x states; or a list, one per step")
    B: Matrices | None = Field(default=None, description="states x inputs; or a list, one per step")
    C: Matrices | None = Field(default=None, description="outputs x states; or a list, one per step")
    process_noise: Covariances | None = Field(
        default=None, description="covariance of w: matrix, diagonal, or a list of matrices; without: none"
    )
    measurement_noise: Covariances | None = Field(
        default=None, description="covariance of v: matrix, diagonal, or a list of matrices; without: none"
    )
    initial: InitialConfig = Field(description="the state at t = 0")
    reference: Vectors | None = Field(
        default=None, description="state to follow: one, or a list, one per step; without: 0"
    )
    feedforward: Vectors | None = Field(
        default=None, description="input beside the feedback: one, or a list, one per step; without: 0"
    )
    feedback: FeedbackConfig | None = Field(default=None, description="controller; without: no feedback")
    observer: ObserverConfig | None = Field(
        default=None, description="estimator of the state; without: the feedback knows the state"
    )

    @property
    def names(self) -> tuple[str, ...]:
        """All signals: states, their estimates if there is an observer, inputs, outputs."""
        estimates = tuple(f"{name}_estimate" for name in self.states) if self.observer else ()
        return (*self.states, *estimates, *self.inputs, *self.outputs)

    @model_validator(mode="after")
    def _good_names(self) -> Self:
        for name in self.names:
            if not re.fullmatch(r"[A-Za-z_]\w*", name):
                raise ValueError(f"{name!r} is no name of a signal: letters, digits and '_' only")
        if len(set(self.names)) != len(self.names):
            raise ValueError("states, estimates, inputs and outputs need names of their own")
        return self

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if bool(self.inputs) != (self.B is not None):
            raise ValueError("inputs and B belong together")
        if bool(self.outputs) != (self.C is not None):
            raise ValueError("outputs and C belong together")
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


def _check_matrices(name: str, matrices: tuple[Matrix, ...] | None, rows: int, columns: int, of: str) -> None:
    for matrix in matrices or ():
        widths = {len(row) for row in matrix}
        if len(matrix) != rows or widths != {columns}:
            found = f"{len(matrix)} x {widths.pop()}" if len(widths) == 1 else "rows of different lengths"
            raise ValueError(f"{name} must be {of}, {rows} x {columns}, not {found}")


def _check_vectors(name: str, vectors: tuple[Vector, ...] | None, size: int, of: str) -> None:
    for vector in vectors or ():
        if len(vector) != size:
            raise ValueError(f"{name} must have one number for each of the {size} {of}, not {len(vector)}")


def _check_covariances(
    name: str, matrices: tuple[Matrix, ...] | None, size: int, of: str, most: int | None = None
) -> None:
    _check_matrices(name, matrices, size, size, f"{of} x {of}")
    if most is not None and len(matrices or ()) > most:
        raise ValueError(f"{name} must be one matrix, or its diagonal")
    for matrix in matrices or ():
        for i in range(size):
            if any(matrix[i][j] != matrix[j][i] for j in range(i)):
                raise ValueError(f"{name} must be symmetric")
            if matrix[i][i] < 0.0:
                raise ValueError(f"{name} has a negative variance on its diagonal")
