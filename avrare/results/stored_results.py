"""Results in files: entries of result.json and the arrays beside it, as ``Result`` values and back.

Whatever cannot be read raises ``UsageError``; missing failures and rollouts are allowed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_arrays, write_arrays
from avrare.base.visible_text import spell_line
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import CrossCheckResult, Failures, Origin, Result, Worst
from avrare.estimation.result.verdict import Verdict

RUN_AGAIN = "run the scenario again"
FAILURES_FILE, FAILURE_FIELDS = "failures.npz", ("noise", "robustness", "count")
SAMPLE_LAW = ("weights", "ancestors")
"""Further fields of the failures, of estimators whose failures are not independent and alike."""
ROLLOUTS_FILE, SAMPLE_FIELDS = "rollouts.npz", ("worst_robustness", "robustness", "worst", "errors")
MAX_SAMPLES = 100_000
"""Stored robustness values of a specification: those of its first rollouts."""
_Stored = TypeVar("_Stored")
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
Name = Annotated[str, AfterValidator(spell_line)]


@dataclass(frozen=True)
class StoredInterval:
    """Interval of a result that was read from a file: known at one confidence."""

    interval: Interval
    confidence: float

    def __call__(self, confidence: float) -> Interval:
        """Return the interval.

        Raises:
            UsageError: It is asked for at another confidence.
        """
        if confidence != self.confidence:
            text = f"the interval of a stored result is known at {self.confidence:g}, not at {confidence:g}"
            raise UsageError(text, f"set `confidence: {confidence:g}` and {RUN_AGAIN}")
        return self.interval


class _StoredCrossCheck(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)

    estimator: Name
    outcome: Literal["agree", "disagree", "inconclusive"]
    share: float = 0.0
    noticed: float | None = None
    result: StoredEstimate | None = None

    def to_check(self) -> CrossCheckResult:
        result = None if self.result is None else self.result.to_result()
        return CrossCheckResult(self.estimator, self.outcome, self.share, self.noticed, result)


class StoredEstimate(BaseModel):
    """Entry of result.json."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)

    specification: Name
    estimator: Name
    probability: _Share
    interval: Annotated[tuple[_Share, _Share], Field(strict=False)]
    confidence: _Share
    relative_error: float | None
    rollouts: int
    simulated_steps: int
    failures: int
    errors: int
    seconds: float
    health: list[Name]
    notes: list[Note]
    verdict: Verdict | None
    trials: int = Field(0, ge=0)
    members: int = Field(0, ge=0)
    shared_by: int = Field(1, ge=1)
    error_share: _Share | None = None
    blind_bound: _Share | None = None
    cross_check: _StoredCrossCheck | None = None
    warnings: dict[str, str] = {}
    counts: dict[str, int] = {}
    run_probabilities: list[float | None] = []
    relation: str = "violated"
    worst_robustness: float | None = None
    diagnostics: dict[str, Any] = {}

    def to_result(
        self,
        failures: Failures | None = None,
        sample: RolloutSample | None = None,
        origin: Origin | None = None,
    ) -> Result:
        """Return the result with the failures and rollouts that are stored beside it."""
        if failures is None:
            failures = Failures(np.zeros((0, 1, 0)), np.zeros(0), self.failures)
        if sample is None:
            sample = RolloutSample(np.zeros(0), Worst(np.zeros((1, 0)), _number(self.worst_robustness)))
        return Result(
            self.specification,
            self.estimator,
            self.probability,
            StoredInterval(self.interval, self.confidence),
            self.confidence,
            np.array([_number(value) for value in self.run_probabilities]),
            _number(self.relative_error),
            self.rollouts,
            self.simulated_steps,
            self.errors,
            {name: self.warnings.get(name, name) for name in self.health},
            failures,
            sample.worst,
            sample.robustness,
            trials=self.trials,
            members=self.members,
            shared_by=self.shared_by,
            error_share=self.error_share,
            notes=tuple(self.notes),
            counts=self.counts,
            diagnostics=self.diagnostics,
            blind_bound=self.blind_bound,
            cross_check=None if self.cross_check is None else self.cross_check.to_check(),
            seconds=self.seconds,
            relation=self.relation,
            verdict=self.verdict,
            error_tapes=sample.error_tapes,
            origin=origin,
        )


def _number(value: float | None) -> float:
    return math.nan if value is None else value


@dataclass(frozen=True)
class RolloutSample:
    """Stored rollouts of one specification.

    ``robustness`` (n,) is of the first rollouts (in splitting: of the first stage), NaN for errors.
    """

    robustness: NDArray[np.float64]
    worst: Worst
    error_tapes: tuple[NDArray[np.float64], ...] = ()


def read_failures(folder: Path) -> dict[str, Failures]:
    """Return the stored failures of each specification; empty where nothing failed."""
    return _read(folder / FAILURES_FILE, (*FAILURE_FIELDS, *SAMPLE_LAW), _to_failures)


def read_rollouts(folder: Path) -> dict[str, RolloutSample]:
    """Return the stored rollouts of each specification; empty where the folder has none."""
    return _read(folder / ROLLOUTS_FILE, SAMPLE_FIELDS, _to_sample)


def _read(path: Path, fields: Sequence[str], convert: Callable[..., _Stored | None]) -> dict[str, _Stored]:
    arrays = read_arrays(path, RUN_AGAIN) if path.exists() else {}
    suffix, values = f".{fields[0]}", {}
    for name in [key.removesuffix(suffix) for key in arrays if key.endswith(suffix)]:
        value = convert(*(arrays.get(f"{name}.{field}", np.array("missing")) for field in fields))
        if value is None:
            raise UsageError(f"{path}: cannot be read: {name} is damaged", RUN_AGAIN)
        values[name] = value
    return values


def _to_failures(
    noise: NDArray[Any], robustness: NDArray[Any], count: NDArray[Any], *law: NDArray[Any]
) -> Failures | None:
    fit = noise.ndim == 3 and robustness.shape == noise.shape[:1] and count.shape == ()
    types = noise.dtype == robustness.dtype == np.float64 and count.dtype.kind == "i"
    valid = fit and types and len(noise) and np.isfinite(noise).all() and not np.isnan(robustness).any()
    weights, ancestors = (None if array.dtype.kind == "U" else array for array in law)
    if weights is not None:
        valid = valid and weights.shape == robustness.shape and weights.dtype == np.float64
        valid = valid and bool((weights >= 0.0).all())
    if ancestors is not None:
        valid = valid and ancestors.shape == (len(noise), 2) and ancestors.dtype.kind == "i"
    return Failures(noise, robustness, int(count), weights, ancestors) if valid else None


def _to_sample(
    least: NDArray[Any], robustness: NDArray[Any], worst: NDArray[Any], errors: NDArray[Any]
) -> RolloutSample | None:
    errors = worst[None][:0] if errors.dtype.kind == "U" else errors
    axes = [(array.dtype.kind, array.ndim) for array in (least, robustness, worst, errors)]
    valid = axes == [("f", 0), ("f", 1), ("f", 2), ("f", 3)]
    sample = Worst(worst, float(least)) if valid else None
    return RolloutSample(robustness.astype(np.float64), sample, tuple(errors)) if sample else None


def write_failures(folder: Path, results: Sequence[Result]) -> None:
    """Write the failing tapes of all results; remove the file where there are none.

    Arrays ``SPECIFICATION.noise`` (F, steps + 1, noise_size), ``.robustness`` (F,) and ``.count`` (), and
    where the estimator gives them ``.weights`` (F,) and ``.ancestors`` (F, 2).
    """
    arrays = {
        f"{result.specification}.{field}": np.asarray(getattr(result.failures, field))
        for result in results
        if len(result.failures.robustness)
        for field in (*FAILURE_FIELDS, *SAMPLE_LAW)
        if getattr(result.failures, field) is not None
    }
    if arrays:
        write_arrays(folder / FAILURES_FILE, arrays, compress=False)
    else:
        (folder / FAILURES_FILE).unlink(missing_ok=True)  # left by an earlier run in the same folder


def write_rollouts(folder: Path, results: Sequence[Result]) -> None:
    """Write the rollouts of all results.

    Arrays ``SPECIFICATION.robustness`` (n,), ``.worst`` (steps + 1, noise_size), ``.worst_robustness`` (),
    and where rollouts ended in an error ``.errors`` (E, steps + 1, noise_size).
    """
    arrays: dict[str, NDArray[Any]] = {}
    for result in results:
        name = result.specification
        arrays[f"{name}.robustness"] = _to_single(result.robustness[:MAX_SAMPLES])
        arrays[f"{name}.worst"] = np.asarray(result.worst.noise)
        arrays[f"{name}.worst_robustness"] = np.asarray(result.worst.robustness)
        if result.error_tapes:
            arrays[f"{name}.errors"] = np.stack(result.error_tapes)
    write_arrays(folder / ROLLOUTS_FILE, arrays)


def _to_single(values: NDArray[np.float64]) -> NDArray[np.float32]:
    with np.errstate(over="ignore", under="ignore"):
        single = np.asarray(values).astype(np.float32)
    # a value that underflows keeps its sign, which tells failures apart
    lost = (single == 0.0) & (values != 0.0)
    tiny = np.copysign(np.finfo(np.float32).tiny, values)
    return np.where(lost, tiny, single).astype(np.float32)
