"""Paired comparison: two versions of a stack on the same noise.

Most rollouts have the same outcome under both versions, and only the others carry information about the
change, so far fewer rollouts distinguish the versions than two estimates with independent noise would need.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from avrare.base.errors import UsageError
from avrare.base.special_functions import beta_quantile
from avrare.estimation.intervals import Interval
from avrare.estimation.plan import Info
from avrare.protocols import Bools
from avrare.rollout.executors.work import Executor, Work
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare.scenario.schema import Scenario

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
            specification, int((first & second).sum()), int((first & ~second).sum()),
            int((~first & second).sum()), int((~first & ~second).sum()), int(error.sum()),
        )  # fmt: skip

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
        """Return the interval of the difference, whatever the outcome of rollouts with errors.

        Newcombe's (1998) square-and-add of the exact limits of the two counts that differ, which covers also
        where hardly any rollout has different outcomes.
        """
        if not self.count:
            return -1.0, 1.0
        # 1. Exact limits of both shares.
        worse, better = self.only_second / self.count, self.only_first / self.count
        (worse_low, worse_high), (better_low, better_high) = (
            _exact_limits(failures, self.count, confidence)
            for failures in (self.only_second, self.only_first)
        )
        # 2. Square and add.
        low = self.difference - math.hypot(worse - worse_low, better_high - better)
        high = self.difference + math.hypot(worse_high - worse, better - better_low)
        # 3. Widen by the share of errors.
        slack = self.errors / (self.count + self.errors)
        low, high = max(-1.0, low), min(1.0, high)
        return (1.0 - slack) * low - slack, (1.0 - slack) * high + slack

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
        """Two-sided p-value of the exact McNemar test of no change."""
        differ, fewer = self.different, min(self.only_first, self.only_second)
        log_half = differ * math.log(0.5)
        tail = sum(
            math.exp(math.lgamma(differ + 1) - math.lgamma(k + 1) - math.lgamma(differ - k + 1) + log_half)
            for k in range(fewer + 1)
        )
        return min(1.0, 2.0 * tail)


def _exact_limits(failures: int, trials: int, confidence: float) -> Interval:
    # Clopper and Pearson, but two-sided at 0 and 1 too
    tail = (1.0 - confidence) / 2.0
    low = beta_quantile(tail, failures, trials - failures + 1) if failures else 0.0
    high = beta_quantile(1.0 - tail, failures + 1, trials - failures) if failures < trials else 1.0
    return low, high


@dataclass(frozen=True)
class PairedComparison:
    """Result of a paired comparison."""

    names: tuple[str, str]
    scenarios: tuple[Scenario, Scenario]  # the resolved ones
    counts: tuple[PairedCounts, ...]  # of each specification
    rollouts: int  # of each version
    seed: int  # of the noise

    @property
    def confidence(self) -> float:
        """Confidence of the intervals: the first scenario's."""
        return self.scenarios[0].confidence

    @property
    def has_too_many_errors(self) -> bool:
        """True if more rollouts ended in an error than the first scenario allows."""
        return max(one.errors for one in self.counts) > self.scenarios[0].max_error_rate * self.rollouts


def compare_pairs(
    first: Problem, second: Problem, rollouts: int, seed: int, executor: Executor,
    watch: PairedWatch | None = None,
) -> list[PairedCounts]:  # fmt: skip
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
            "steps, simulator and perception must be alike; compare two `avrare run` results instead",
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
