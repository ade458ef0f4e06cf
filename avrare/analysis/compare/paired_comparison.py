"""Paired comparison: two versions of a stack on the same noise.

Most rollouts have the same outcome under both versions, and only the others carry information about the
change, so far fewer rollouts distinguish the versions than two estimates with independent noise would need.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from avrare.analysis.compare.study import StudyWatch, parse_cost
from avrare.base.errors import UsageError, require_path
from avrare.base.number_format import format_difference, format_signed_interval
from avrare.base.records import Answer, Records
from avrare.base.special_functions import bisect, normal_factor
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Info
from avrare.estimation.result.intervals import Interval
from avrare.protocols import Bools
from avrare.rollout.executors.work import Executor, Work, build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare.scenario.fingerprint import comparable
from avrare.scenario.load import load
from avrare.scenario.overrides import as_settings
from avrare.scenario.safe_mode import safe_mode
from avrare.scenario.schema import Scenario

_ROLLOUTS = 1000
"""Default number of rollouts of each version."""
_FEW_DIFFERENCES = 10
"""Rollouts with different outcomes below which a note asks for more."""

PairedWatch = Callable[[int], Callable[[Info], None]]
"""Called with 0 and 1 as the first and the second version begin; gives the progress display."""


@dataclass(frozen=True)
class PairedCounts:
    """Rollouts by the versions under which they failed, for one specification."""

    specification: str
    both: int
    only_first: int
    only_second: int
    neither: int
    errors: int = 0  # rollouts with an error under one version or both; not in the other counts

    @staticmethod
    def from_outcomes(specification: str, first: Bools, second: Bools, error: Bools) -> PairedCounts:
        """Count (n,) failures under both versions."""
        first, second = first[~error], second[~error]
        return PairedCounts(
            specification,
            int((first & second).sum()),
            int((first & ~second).sum()),
            int((~first & second).sum()),
            int((~first & ~second).sum()),
            int(error.sum()),
        )

    @property
    def count(self) -> int:
        """Rollouts without errors."""
        return self.both + self.only_first + self.only_second + self.neither

    @property
    def different(self) -> int:
        """Rollouts with different outcomes."""
        return self.only_first + self.only_second

    @property
    def first(self) -> float:
        """Failure probability of the first version."""
        return self._share(self.both + self.only_first)

    @property
    def second(self) -> float:
        """Failure probability of the second version."""
        return self._share(self.both + self.only_second)

    @property
    def difference(self) -> float:
        """Failure probability of the second version minus that of the first."""
        return self._share(self.only_second - self.only_first)

    def _share(self, rollouts: int) -> float:
        return rollouts / self.count if self.count else math.nan

    def interval(self, confidence: float) -> Interval:
        """Return Tango's score interval of the difference (Statistics in Medicine 17, 1998).

        It holds whatever the outcome of rollouts with errors: they count against either end.
        """
        total, factor = self.count + self.errors, normal_factor(confidence)
        better, worse = self.only_first, self.only_second

        def end(better: int, worse: int, target: float) -> float:
            return bisect(lambda change: -_score(better, worse, total, change), target, -1.0, 1.0)

        return end(better + self.errors, worse, -factor), end(better, worse + self.errors, factor)

    def verdict(self, confidence: float) -> str:
        """Return "worse", "better", "same" (no outcome differs) or "not known"."""
        low, high = self.interval(confidence)
        if low > 0.0:
            return "worse"
        if high < 0.0:
            return "better"
        return "not known" if self.different + self.errors else "same"

    @property
    def p_value(self) -> float:
        """Two-sided p-value of the score test of no change (McNemar's), which the interval inverts.

        It is below 1 - confidence exactly where the interval excludes 0.
        """
        lead = abs(self.only_first - self.only_second) - self.errors
        return math.erfc(lead / math.sqrt(2.0 * (self.different + self.errors))) if lead > 0 else 1.0


def _score(better: int, worse: int, total: int, change: float) -> float:
    """Return Tango's statistic of "the difference is ``change``": standard normal if it is."""
    # 1. The likeliest share of ``better`` for this difference, from its quadratic equation.
    b = 2.0 * total * change - (worse + better) + (better - worse) * change
    c = -better * change * (1.0 - change)
    root = math.sqrt(max(b * b - 8.0 * total * c, 0.0))
    share = -2.0 * c / (root + b) if b > 0.0 else (root - b) / (4.0 * total)
    # 2. The distance from it in standard errors.
    distance = worse - better - total * change
    variance = total * (2.0 * share + change * (1.0 - change))
    if variance <= 0.0:
        return math.copysign(math.inf, distance) if distance else 0.0
    return distance / math.sqrt(variance)


@dataclass(frozen=True, repr=False)
class PairedComparison(Answer):
    """Result of a paired comparison.

    Attributes:
        names: The files.
        scenarios: The resolved scenarios.
        counts: Counts of each specification.
        rollouts: Rollouts of each version.
        seed: Seed of the noise.
    """

    names: tuple[str, str]
    scenarios: tuple[Scenario, Scenario]
    counts: tuple[PairedCounts, ...]
    rollouts: int
    seed: int

    @property
    def confidence(self) -> float:
        """Confidence of the intervals: the first scenario's."""
        return self.scenarios[0].confidence

    @property
    def has_too_many_errors(self) -> bool:
        """True if more rollouts ended in an error than the first scenario allows."""
        return max(counts.errors for counts in self.counts) > self.scenarios[0].max_error_rate * self.rollouts

    def headline(self) -> list[str]:
        """Return what was compared."""
        first, second = self.names
        other = second if second != first else f"{second} with other settings"
        return [f"{first} against {other}: {self.rollouts:,} rollouts each, on the same noise"]

    def summary(self) -> list[str]:
        """Return ``safe_distance: worse, +0.012 (+0.004 .. +0.02)`` for each specification."""
        lines = []
        for counts in self.counts:
            change = format_difference(counts.difference)
            interval = format_signed_interval(counts.interval(self.confidence))
            lines.append(f"{counts.specification}: {counts.verdict(self.confidence)}, {change} ({interval})")
        return lines

    def notes(self) -> list[str]:
        """Return remarks for the reader of the table."""
        lines = self._note_other_changes()
        for counts in self.counts:
            if 0 < counts.different < _FEW_DIFFERENCES:
                few = f"{counts.different} rollout{'s' * (counts.different > 1)}"
                lines.append(f"{counts.specification}: only {few} with different outcomes: use more rollouts")
        errors = self.counts[0].errors
        if errors:
            counts_text = f"{errors} of {self.rollouts} rollouts ended in an error"
            lines.append(f"{counts_text}: the intervals allow for both outcomes")
        return lines

    def _note_other_changes(self) -> list[str]:
        """Return which rules differ, and whether the simulators do: the change is not the stack's alone."""
        first, second = map(comparable, self.scenarios)
        rules = [counts.specification for counts in self.counts]
        changed = [name for name in rules if first["specifications"][name] != second["specifications"][name]]
        lines = [f"{', '.join(changed)}: the two versions judge by different rules"] if changed else []
        if first["simulator"] != second["simulator"]:
            lines.append("the two versions have different simulators")
        return [f"{line}: the change is not that of the stack alone" for line in lines]

    def table(self) -> Records:
        """Return one row for each specification."""
        return Records(
            {
                "specification": counts.specification,
                "first": counts.first,
                "second": counts.second,
                "change": counts.difference,
                "low": counts.interval(self.confidence)[0],
                "high": counts.interval(self.confidence)[1],
                "mended": counts.only_first,
                "newly_failing": counts.only_second,
                "p_value": counts.p_value,
                "verdict": counts.verdict(self.confidence),
            }
            for counts in self.counts
        )

    def lines(self) -> list[str]:
        """Return what was compared, the change of each specification, and the notes."""
        return [*self.headline(), *self.summary(), *self.notes()]


def compare_versions(
    first: str | os.PathLike[str],
    second: str | os.PathLike[str],
    specification: str | None = None,
    *,
    budget: Budget | Mapping[str, float] | str | None = None,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    workers: int = 1,
    watch: StudyWatch | None = None,
    safe: bool = False,
) -> PairedComparison:
    """Run two versions of a scenario on the same noise, and tell how each probability changes.

    Args:
        first: Scenario file.
        second: The other version of it.
        specification: Name; None: all that both estimate.
        budget: Budget of each version, in steps or rollouts; None: 1000 rollouts.
        overrides: Settings: ``"scenario.steps=20"`` for both, ``"against.steps=20"`` for the second only.
        seed: Seed of the noise; None: the first scenario's.
        workers: Number of processes; changes no number.
        watch: Progress display.
        safe: As for ``avrare.load``.

    Raises:
        UsageError: They have no specification in common, or cannot share their noise.
    """
    names = require_path(first, "a scenario file"), require_path(second, "a scenario file")
    both, second_only = _split_settings(as_settings(overrides))
    with safe_mode(safe):
        definitions = load(first, both), load(second, [*both, *second_only])
    problems = [
        LoadedScenario(definition).problem(specification or definition.estimated)
        for definition in definitions
    ]
    seed, rollouts = definitions[0].seed if seed is None else seed, _count_rollouts(budget, problems[0].steps)

    def begin(number: int) -> Callable[[Info], None]:
        label = f"{names[number]}  {number + 1} of 2"
        return watch(label, problems[number]) if watch is not None else lambda info: None

    counts = compare_pairs(problems[0], problems[1], rollouts, seed, build_executor(workers), begin)
    return PairedComparison(names, definitions, tuple(counts), rollouts, seed)


def _split_settings(settings: Sequence[str]) -> tuple[list[str], list[str]]:
    both: list[str] = []
    second_only: list[str] = []
    for text in settings:
        prefix, _, rest = text.partition(".")
        if prefix not in ("scenario", "against") or not rest:
            raise UsageError(
                f"{text}: a setting of two versions begins with scenario. or against.",
                "write scenario.KEY=VALUE for both, against.KEY=VALUE for the second only",
            )
        (both if prefix == "scenario" else second_only).append(rest)
    return both, second_only


def _count_rollouts(given: Budget | Mapping[str, float] | str | None, steps: int) -> int:
    if given is None:
        return _ROLLOUTS
    budget = parse_cost(given)
    rollouts = int(budget.amount // (max(steps, 1) if budget.kind == "steps" else 1))
    if rollouts < 1:
        raise UsageError(f"the budget {given} does not cover one rollout of {steps} steps")
    return rollouts


def compare_pairs(
    first: Problem,
    second: Problem,
    rollouts: int,
    seed: int,
    executor: Executor,
    watch: PairedWatch | None = None,
) -> list[PairedCounts]:
    """Simulate both problems on the same noise and count the outcomes of each common specification.

    UsageError if they have none in common, or if their noise tapes have different shapes.
    """
    names = [name for name in first.names if name in second.names]
    if not names:
        raise UsageError(
            "the two scenarios have no specification in common",
            f"{', '.join(first.names)} on one side, {', '.join(second.names)} on the other",
        )
    shapes = [(problem.steps, problem.noise_size) for problem in (first, second)]
    if shapes[0] != shapes[1]:
        raise UsageError(
            "the two scenarios cannot share their noise: "
            + " and ".join(f"{steps} steps of {size} numbers" for steps, size in shapes),
            "give both as many steps, and parts that read as much noise: the same simulator and perception",
        )
    outcomes = [
        _simulate(problem, rollouts, seed, executor, watch(number) if watch else lambda info: None)
        for number, problem in enumerate((first, second))
    ]
    error = outcomes[0].error | outcomes[1].error
    one, other = (
        {name: found.violated[:, k] for k, name in enumerate(problem.names)}
        for found, problem in zip(outcomes, (first, second), strict=True)
    )
    return [PairedCounts.from_outcomes(name, one[name], other[name], error) for name in names]


def _simulate(
    problem: Problem, rollouts: int, seed: int, executor: Executor, progress: Callable[[Info], None]
) -> Rollouts:
    noise, parts, info = NoiseSource(seed, problem.noise_size), [], Info(goal=rollouts)
    rows = (np.arange(at, min(at + problem.chunk, rollouts)) for at in range(0, rollouts, problem.chunk))
    executor.open(Work(problem, noise, scored=False))
    with closing(executor):
        for part in executor.map(Request.from_start(np.zeros_like(index), index) for index in rows):
            parts.append(part)
            info = info.plus(part)
            progress(info)
    return Rollouts.join(parts)
