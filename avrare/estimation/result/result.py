"""Result of an estimate: probability, interval, cost and health warnings."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.base.number_format import format_estimate
from avrare.base.plot import Plot
from avrare.base.records import Records
from avrare.base.renderers import render
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.note import Note
from avrare.protocols import Floats
from avrare.rollout.loaded_scenario import AnyEstimator
from avrare.rollout.problem import Problem
from avrare.rollout.replay import Trace, trace_tape


@dataclass(frozen=True)
class Failures:
    """Failing noise tapes, up to a limit: a sample of the noise given failure.

    Attributes:
        noise: (F, steps + 1, noise_size).
        robustness: (F,).
        count: Number of failing rollouts, kept or not.
        weights: (F,) contribution of each to the probability; they add up to it; None: equal parts.
        ancestors: (F, 2) run and first ancestor of each, for those that share noise; None: independent.
    """

    noise: Floats
    robustness: Floats
    count: int
    weights: Floats | None = None
    ancestors: NDArray[np.int64] | None = None


def spread(rows: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return at most ``most`` of ``rows``, evenly spaced: failures of all runs, not of the first alone."""
    most = min(most, len(rows))
    return rows[np.arange(most) * len(rows) // most]


@dataclass(frozen=True)
class Worst:
    """The rollout with the least robustness."""

    noise: Floats  # (steps + 1, noise_size)
    robustness: float  # NaN when every rollout ended in an error


@dataclass(frozen=True)
class CrossCheckResult:
    """Second estimate of the same probability, by an estimator of another family; its cost is its own.

    Attributes:
        estimator: Name of the estimator.
        outcome: "agree", "disagree" or "inconclusive".
        share: Cost that was meant for it, as a share of the estimate's.
        noticed: Least factor between the two estimates that would have counted as disagreement.
        result: The second estimate, without its tapes; None where it did not run.
    """

    estimator: str
    outcome: str
    share: float
    noticed: float | None = None
    result: Result | None = None

    def to_dict(self) -> dict[str, object]:
        """Return the entry of result.json."""
        return vars(self) | {"result": self.result and self.result.to_dict()}


@dataclass(frozen=True)
class Origin:
    """Problem and estimator of a result; those of a run folder are built on first use.

    Attributes:
        build: Gives the problem with the result's specification, and the estimator; an ``AvrareError`` says
            why they cannot be built.
        seed: Seed of the estimate.
        call: Call or command that gives the result again, for people.
    """

    build: Callable[[], tuple[Problem, AnyEstimator]]
    seed: int
    call: str

    @cached_property
    def _parts(self) -> tuple[Problem, AnyEstimator]:
        return self.build()

    @property
    def problem(self) -> Problem:
        """Problem with the result's specification."""
        return self._parts[0]

    @property
    def estimator(self) -> AnyEstimator:
        """The estimator."""
        return self._parts[1]


@dataclass(frozen=True, repr=False)
class Result:
    """One estimate of one specification's failure probability.

    Attributes:
        specification: Name of the specification.
        estimator: Name of the estimator.
        probability: Mean of ``run_probabilities``.
        interval_at: Function from a confidence to the interval.
        confidence: Level of ``interval``, in (0, 1).
        run_probabilities: Estimate of each run (runs,); 0.0 for a run that died out.
        relative_error: Standard error over probability; NaN where the probability is 0.
        rollouts: Number of starts and branches.
        simulated_steps: Particle rows passed to ``System.step``.
        errors: Number of rollouts that ended in an error.
        health: Health warnings, name to message; empty when there are none.
        failures: Failing tapes.
        worst: Least robust rollout.
        robustness: Robustness of each complete rollout of the first stage, NaN for errors; of Monte Carlo, of
            the first 100,000 rollouts. Empty, or None to the constructor, where the estimator keeps none.
        trials: Independent rollouts of which ``failures.count`` failed; 0 where the law is not binomial.
        members: Models of an ensemble whose estimates ``run_probabilities`` are; 0: they are of runs.
        shared_by: Specifications that share the rollouts.
        error_share: Probability that a rollout ends in an error, where it is not errors over rollouts.
        notes: Sentences about the estimate, the same in every table, page and notebook.
        counts: Counters of the system, summed over all rollouts.
        diagnostics: Further numbers (levels, roots, ...), JSON-ready, that only their estimator reads.
        artifacts: What the estimator leaves in the run folder: JSON data by the name of the file.
        blind_bound: Upper bound, at ``confidence``, for failures that the score or proposal does not lead to;
            None where every rollout was drawn from the target, as in Monte Carlo.
        fresh: Counts of the rollouts drawn from the target, where that is not all of the estimate.
        unopened_at: ``interval_at`` before doubts opened it; None where nothing did.
        least_upper: Probability that a probe or a check of the estimate allows, whatever the estimate says.
        cross_check: Second estimate that the option ``cross_check`` asked for; not in the cost above.
        seconds: Wall time [s]; no other field depends on it.
        relation: Definition of failure: "violated", the formula is false at sample 0, or "robustness <= 0".
        error_tapes: Noise tapes (steps + 1, noise_size) of the first rollouts that ended in an error; of
            splitting, of those that did so without having branched.
        verdict: Worst verdict on the thresholds of the scenario (``estimation.result.verdict``), or None.
        origin: Problem and call, for ``trace`` and ``report``; neither written, pickled nor compared.
    """

    specification: str
    estimator: str
    probability: float
    interval_at: Callable[[float], Interval]
    confidence: float
    run_probabilities: Floats
    relative_error: float
    rollouts: int
    simulated_steps: int
    errors: int
    health: dict[str, str]
    failures: Failures
    worst: Worst
    robustness: Floats = field(default_factory=lambda: np.zeros(0))
    trials: int = 0
    members: int = 0
    shared_by: int = 1
    error_share: float | None = None
    notes: tuple[Note, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)
    diagnostics: dict[str, Any] = field(default_factory=dict)
    artifacts: dict[str, Any] = field(default_factory=dict)
    blind_bound: float | None = None
    fresh: FreshRows | None = None
    unopened_at: Callable[[float], Interval] | None = field(default=None, compare=False)
    least_upper: float = field(default=0.0, compare=False)
    cross_check: CrossCheckResult | None = None
    seconds: float = 0.0
    relation: str = "violated"
    verdict: str | None = None
    error_tapes: tuple[Floats, ...] = field(default=(), compare=False)
    origin: Origin | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if self.robustness is None:
            object.__setattr__(self, "robustness", np.zeros(0))

    @cached_property
    def interval(self) -> Interval:
        """Interval (lo, hi) with 0 <= lo <= probability <= hi <= 1."""
        return self.interval_at(self.confidence)

    def require_origin(self) -> Origin:
        """Return the origin, for analyses that run rollouts.

        Raises:
            UsageError: The result does not know it.
        """
        if self.origin is None:
            raise UsageError(
                f"the result of {self.specification} does not know its problem, so no rollout can run again",
                "use it where avrare.estimate or avrare.run gave it, or read its run folder",
            )
        return self.origin

    def without_tapes(self) -> Result:
        """Return the result without failing tapes and rollouts, of which many fit into memory."""
        failures = Failures(self.failures.noise[:0], self.failures.robustness[:0], self.failures.count)
        return replace(self, failures=failures, robustness=self.robustness[:0])

    def to_dict(self) -> dict[str, object]:
        """Return the entry of result.json; NaN and infinities become None."""
        entry = {
            "specification": self.specification,
            "estimator": self.estimator,
            "probability": self.probability,
            "interval": list(self.interval),
            "confidence": self.confidence,
            "blind_bound": self.blind_bound,
            "relative_error": self.relative_error,
            "rollouts": self.rollouts,
            "simulated_steps": self.simulated_steps,
            "failures": self.failures.count,
            "errors": self.errors,
            "trials": self.trials,
            "members": self.members,
            "shared_by": self.shared_by,
            "error_share": self.error_share,
            "seconds": round(self.seconds, 3),
            "health": list(self.health),
            "notes": [asdict(note) for note in self.notes],
            "verdict": self.verdict,
            "warnings": self.health,
            "cross_check": self.cross_check and self.cross_check.to_dict(),
            "run_probabilities": self.run_probabilities.tolist(),
            "relation": self.relation,
            "worst_robustness": self.worst.robustness,
            "counts": self.counts,
            "diagnostics": self.diagnostics,
        }
        return finite(entry)

    def to_json(self) -> str:
        """Return ``to_dict`` as JSON text."""
        return json.dumps(self.to_dict())

    def table(self) -> Records:
        """Return the main numbers as one row; ``.frame()`` of it is a DataFrame."""
        low, high = self.interval
        row = {
            "specification": self.specification,
            "estimator": self.estimator,
            "probability": self.probability,
            "low": low,
            "high": high,
            "relative_error": self.relative_error,
            **{column.name: column.count(self) for column in COLUMNS},
            "seconds": self.seconds,
            "verdict": self.verdict,
            "warnings": tuple(self.health),
        }
        return Records([row])

    def plot(self) -> Plot:
        """Draw estimate, interval, runs and the robustness of the rollouts (needs matplotlib)."""
        return Results([self]).plot()

    def trace(self, index: int | None = None) -> Trace:
        """Replay the least robust rollout, or the kept failure ``index``.

        Raises:
            UsageError: The failure does not exist, or the result does not know its problem.
        """
        problem = self.require_origin().problem
        if index is None:
            if np.isnan(self.worst.robustness):
                raise UsageError("every rollout ended in an error, so there is none to trace")
            return trace_tape(problem, self.worst.noise)
        count = len(self.failures.robustness)
        if not 0 <= index < count:
            hint = f"it keeps {count} failures, numbered from 0" if count else "no rollout failed"
            raise UsageError(f"the result has no failure {index}", hint)
        return trace_tape(problem, self.failures.noise[index])

    def report(self, path: str | os.PathLike[str]) -> Path:
        """Write the result as one HTML file and return its path.

        Raises:
            UsageError: The file cannot be written, or the result does not know its problem.
        """
        return Results([self]).report(path)

    def __repr__(self) -> str:
        numbers = format_estimate(self.probability, self.interval)
        warned = f", warnings: {', '.join(self.health)}" if self.health else ""
        cost = f"{self.estimator}, {self.rollouts:,} rollouts"
        cost += f", {self.errors:,} errors" if self.errors else ""
        return f"<Result {self.specification}: {numbers}, {cost}{warned}>"

    def _repr_html_(self) -> str:
        return Results([self])._repr_html_()

    def __getstate__(self) -> dict[str, object]:
        return self.__dict__ | {"origin": None}


@dataclass(frozen=True)
class Column:
    """Count of a result, with a column in every table: terminal, notebook, report and ``Result.table``.

    Attributes:
        name: Heading.
        count: Function that returns the count of a result.
        optional: Whether narrow tables leave it out where it is 0 for all results.
    """

    name: str
    count: Callable[[Result], int]
    optional: bool = False


COLUMNS = (
    Column("rollouts", lambda result: result.rollouts),
    Column("failures", lambda result: result.failures.count),
    Column("errors", lambda result: result.errors, optional=True),
)


def choose_columns(results: Sequence[Result]) -> list[Column]:
    """Return the columns of a narrow table."""
    return [column for column in COLUMNS if not column.optional or any(map(column.count, results))]


class ResultMapping(Mapping[str, Result]):
    """Results by specification, in their order; they print and draw themselves."""

    def table(self) -> Records:
        """Return one row for each result; ``.frame()`` of it is a DataFrame."""
        return Records(row for result in self.values() for row in result.table())

    def plot(self) -> Plot:
        """Draw all estimates with their intervals (needs matplotlib)."""
        plot: Plot = render("plot", self)
        return plot

    def report(self, path: str | os.PathLike[str] | None = None) -> Path:
        """Write the HTML report, by default ``report.html`` in the run folder, and return its path.

        Raises:
            UsageError: The file cannot be written, there is neither a path nor a folder, or a result does not
                know its problem.
        """
        written: Path = render("report", self, path)
        return written

    def __repr__(self) -> str:
        return "\n".join(map(repr, self.values()))

    def _repr_html_(self) -> str:
        table: str = render("render_html", self)
        return table


class Results(ResultMapping):
    """Results of several specifications of a problem."""

    def __init__(self, results: Iterable[Result]) -> None:
        self._results = {result.specification: result for result in results}

    def __getitem__(self, name: str) -> Result:
        return self._results[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._results)

    def __len__(self) -> int:
        return len(self._results)


def finite(entries: Mapping[str, object]) -> dict[str, object]:
    """Replace NaN and infinities by None, as JSON cannot write them."""
    return {key: _finite(value) for key, value in entries.items()}


def _finite(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return finite(value)
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    return value
