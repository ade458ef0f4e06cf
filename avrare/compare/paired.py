"""Two versions of a stack on the same noise: the paired difference of their failure probabilities.

Most rollouts come out alike under both versions. Only those that differ say anything about the change, so
that far fewer rollouts tell the versions apart than two estimates with their own noise would need.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from avrare.errors import UsageError
from avrare.estimation.intervals import Interval, beta_quantile
from avrare.estimation.plan import Info
from avrare.execute.work import Executor, Work
from avrare.protocols import Bools
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare.scenario.schema import Scenario

_CHUNKS_AT_ONCE = 8
Watch = Callable[[int], Callable[[Info], None]]
"""Called with 0 and with 1 when the first and the second version begin."""


@dataclass(frozen=True)
class Pairs:
    """One specification under both versions, over n rollouts that neither broke down in.

    Attributes:
        specification: Its name.
        both: Rollouts that failed under both versions.
        only_first: Under the first alone.
        only_second: Under the second alone.
        neither: Under none.
        undecided: Rollouts that broke down under one or both.
    """

    specification: str
    both: int
    only_first: int
    only_second: int
    neither: int
    undecided: int = 0

    @staticmethod
    def of(specification: str, first: Bools, second: Bools, broken: Bools) -> Pairs:
        """Counted from (n,) failures under both versions."""
        first, second = first[~broken], second[~broken]
        return Pairs(
            specification, int((first & second).sum()), int((first & ~second).sum()),
            int((~first & second).sum()), int((~first & ~second).sum()), int(broken.sum()),
        )  # fmt: skip

    @property
    def count(self) -> int:
        """Rollouts that count."""
        return self.both + self.only_first + self.only_second + self.neither

    @property
    def first(self) -> float:
        """Failure probability of the first version."""
        return (self.both + self.only_first) / self.count if self.count else math.nan

    @property
    def second(self) -> float:
        """Failure probability of the second version."""
        return (self.both + self.only_second) / self.count if self.count else math.nan

    @property
    def difference(self) -> float:
        """Second minus first."""
        return (self.only_second - self.only_first) / self.count if self.count else math.nan

    def interval(self, confidence: float) -> Interval:
        """Of the difference; rollouts that broke down may have gone either way.

        Newcombe's (1998) square-and-add of the exact limits of the two counts that differ: it covers where
        hardly any rollout came out differently, too.
        """
        if not self.count:
            return -1.0, 1.0
        worse, better = self.only_second / self.count, self.only_first / self.count
        (worse_low, worse_high), (better_low, better_high) = (
            _limits(failures, self.count, confidence) for failures in (self.only_second, self.only_first)
        )
        low = self.difference - math.hypot(worse - worse_low, better_high - better)
        high = self.difference + math.hypot(worse_high - worse, better - better_low)
        slack = self.undecided / (self.count + self.undecided)
        low, high = max(-1.0, low), min(1.0, high)
        return (1.0 - slack) * low - slack, (1.0 - slack) * high + slack

    @property
    def p_value(self) -> float:
        """Two-sided exact test of McNemar: how surprising so lopsided a split would be without a change."""
        differ, fewer = self.only_first + self.only_second, min(self.only_first, self.only_second)
        log_half = differ * math.log(0.5)
        tail = sum(
            math.exp(math.lgamma(differ + 1) - math.lgamma(k + 1) - math.lgamma(differ - k + 1) + log_half)
            for k in range(fewer + 1)
        )
        return min(1.0, 2.0 * tail)


def _limits(failures: int, trials: int, confidence: float) -> Interval:
    """Both exact limits of a share, two-sided at 0 and 1 too."""
    tail = (1.0 - confidence) / 2.0
    low = beta_quantile(tail, failures, trials - failures + 1) if failures else 0.0
    high = beta_quantile(1.0 - tail, failures + 1, trials - failures) if failures < trials else 1.0
    return low, high


@dataclass(frozen=True)
class Paired:
    """What was compared and what came out.

    Attributes:
        names: Of the two versions.
        scenarios: The two, resolved.
        pairs: One entry for each specification.
        rollouts: Of each version.
        seed: Of the noise.
    """

    names: tuple[str, str]
    scenarios: tuple[Scenario, Scenario]
    pairs: tuple[Pairs, ...]
    rollouts: int
    seed: int

    @property
    def confidence(self) -> float:
        """Of the intervals: the first scenario's."""
        return self.scenarios[0].confidence

    @property
    def troubled(self) -> bool:
        """More rollouts broke down than the first scenario allows."""
        return max(pair.undecided for pair in self.pairs) > self.scenarios[0].max_error_rate * self.rollouts


def compare_pairs(
    first: Problem, second: Problem, rollouts: int, seed: int, executor: Executor, watch: Watch | None = None
) -> list[Pairs]:
    """Drive both problems on the same noise; one entry for each specification that both have.

    Raises:
        UsageError: They have no specification in common, or read another amount of noise.
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
        _drive(problem, rollouts, seed, executor, watch(number) if watch else lambda info: None)
        for number, problem in enumerate((first, second))
    ]
    broken = outcomes[0].error | outcomes[1].error
    return [
        Pairs.of(
            name,
            outcomes[0].violated[:, first.names.index(name)],
            outcomes[1].violated[:, second.names.index(name)],
            broken,
        )
        for name in names
    ]


def _drive(
    problem: Problem, rollouts: int, seed: int, executor: Executor, progress: Callable[[Info], None]
) -> Rollouts:
    noise, parts, info = NoiseSource(seed, problem.noise_size), [], Info(goal=rollouts)
    executor.open(Work(problem, noise, scored=False))
    with closing(executor):
        for first in range(0, rollouts, _CHUNKS_AT_ONCE * problem.chunk):
            index = np.arange(first, min(first + _CHUNKS_AT_ONCE * problem.chunk, rollouts))
            wave = Request.from_start(np.zeros_like(index), index)
            chunks = [wave.slice(at, at + problem.chunk) for at in range(0, wave.rows, problem.chunk)]
            for part in executor.map(chunks):
                parts.append(part)
                info = info.plus(part)
                progress(info)
    return Rollouts.join(parts)
