"""Requirement: the largest (or smallest) value of a parameter that keeps a probability below a bound.

A few small runs look for the value at which the bound is reached: values are chosen by a line through log p,
as near to its root as the next estimate can tell apart. Half of the budget then decides. Where the failures
of a run can be reweighed for nearby values (``reweighed_trial``) far enough, it is one run at the root, else
one on each side of it. Where the bound is too rare for small runs, only those at the ends are small: the rest
goes into few that are large enough to learn where failures are. Each run has noise of its own, so the values
may be chosen from earlier trials, and the risks of all of them add up to alpha (Bonferroni). The values that
a run is reweighed for are tested in an order that is fixed before it, from the safe end until one fails,
which needs no correction (fixed-sequence testing). If the probability is monotone in the parameter, the value
at which it reaches the bound then lies between the last value that is shown to keep the bound and the first
that is shown to break it, with the confidence 1 - alpha.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from avrare.base.errors import UsageError
from avrare.base.special_functions import normal_factor
from avrare_design.requirement import Requirement, Trial
from avrare_design.reweighed_trial import Nearby

SHARES = (1, 1, 1, 1, 2, 2, 4, 4)
"""Parts of the budget of the estimates: the first two at the ends, the last two decide, or one for both."""
_SEARCH_ESTIMATES = 6
"""Estimates that only look for the root,"""
_SEARCH_RISK = 0.15
"""and their part of the risk."""
_LARGE_ROLLOUTS = 32_000
"""Rollouts that find failures of 1e-6 and check what they have found."""


Evaluate = Callable[[float, float, int, float, Sequence[float]], Trial]
"""Called with a value, a share of the budget, the number of the trial, the level of its intervals, and the
values to reweigh its failures for."""


def find_requirement(
    evaluate: Evaluate,
    parameter: str,
    specification: str,
    limit: float,
    between: tuple[float, float],
    *,
    confidence: float = 0.95,
    logarithmic: bool = True,
) -> Requirement:
    """Find the value of a parameter at which a probability reaches ``limit``.

    Args:
        evaluate: Estimates the probability at a value.
        parameter: Name, for the answer.
        specification: Name, for the answer.
        limit: The bound, in (0, 1).
        between: Smallest and largest value to try.
        confidence: Level of the answer.
        logarithmic: Look along the logarithm of the parameter, where both ends are positive.

    Raises:
        UsageError: The bound or the ends do not fit.
    """
    low, high = between
    if not 0.0 < limit < 1.0 or not -math.inf < low < high < math.inf:
        raise UsageError(f"{parameter}: bound {limit:g} between {low:g} and {high:g} cannot be searched")
    search = _Search(evaluate, limit, 1.0 - confidence, logarithmic and low > 0.0, between)
    if search.look():
        search.decide()
    trials = search.trials
    keeping, broken = search.bracket()
    return Requirement(
        parameter,
        specification,
        limit,
        keeping,
        broken,
        search.root(),
        confidence,
        tuple(trials),
        search.rising,
        _doubts(trials, limit, search.rising, keeping),
    )


@dataclass
class _Search:
    evaluate: Evaluate
    limit: float
    alpha: float
    scaled: bool
    between: tuple[float, float]
    trials: list[Trial] = field(default_factory=list)
    shares: list[float] = field(default_factory=list)

    def look(self) -> bool:
        """Run the small trials; return whether there is something left to decide."""
        level = 1.0 - self.alpha * _SEARCH_RISK / _SEARCH_ESTIMATES
        for number in range(_SEARCH_ESTIMATES):
            if number == 2 and self._is_rare():
                return True
            value = self.between[number] if number < 2 else self._choose(SHARES[number], level)
            if value is None:
                return False
            self._run(value, SHARES[number], level)
            sides = {
                trial.interval[1] < self.limit or (trial.interval[0] > self.limit and None)
                for trial in self.trials
            }
            if number == 1 and sides in ({True}, {None}):  # both ends keep the bound, or both break it
                return False
        return True

    def decide(self) -> None:
        """Run the deciding trials: one that is reweighed to both sides of the root, or one on each side."""
        risk, line = self.alpha * (1.0 - _SEARCH_RISK), self._fit()
        if self._is_rare():
            left = sum(SHARES[2:])
            runs = min(max(left * self.trials[0].result.rollouts // _LARGE_ROLLOUTS, 1), 4)
            self._run_all([left / runs] * runs, risk)
            return
        shares = SHARES[_SEARCH_ESTIMATES:]
        expected = self.limit * self.trials[-1].result.rollouts * sum(shares) / SHARES[_SEARCH_ESTIMATES - 1]
        half = normal_factor(1.0 - risk) / math.sqrt(expected)
        # least distance in log p that reweighing must reach, in half widths of the interval there
        least_half_widths = 1.5
        if line is not None and self._reach() * abs(line[1]) >= least_half_widths * half:
            value = self._inside(line[0])
            self._run(value, sum(shares), 1.0 - risk, self._grid(value))
            return
        self._run_all(shares, risk)

    def _run_all(self, shares: Sequence[float], risk: float) -> None:
        level = 1.0 - risk / len(shares)
        for share in shares:
            chosen = self._choose(share, level)
            if chosen is not None:
                self._run(chosen, share, level, self._grid(chosen))

    def _is_rare(self) -> bool:
        """Return whether small runs mostly show neither failures nor that the bound is kept."""
        return any(
            not end.result.probability and self.limit * end.result.rollouts < 4.0  # expected failures
            for end in self.trials[:2]
        )

    def bracket(self) -> tuple[float | None, float | None]:
        """Return the last value that is shown to keep the bound, and the first that is shown to break it."""
        inner, outer = (max, min) if self.rising else (min, max)
        keeping = (value for trial in self.trials for value in self._give_values(trial, True))
        broken = (value for trial in self.trials for value in self._give_values(trial, False))
        return inner(keeping, default=None), outer(broken, default=None)

    def root(self) -> float | None:
        """Return the value between the ends at which the fitted line reaches the bound; None without one."""
        line, (low, high) = self._fit(), self.between
        if line is None or not _to_axis(low, self.scaled) <= line[0] <= _to_axis(high, self.scaled):
            return None  # nor has a nearly flat line a root that is a number
        return _to_value(line[0], self.scaled)

    @property
    def rising(self) -> bool:
        """True if the probability rises with the parameter, as is shown, or else as the line does."""
        direction = _find_direction(self.trials)
        if direction is not None:
            return direction
        if (line := self._fit()) is not None:
            return line[1] > 0.0
        first, last = self.trials[0], self.trials[-1]
        return (last.result.probability - first.result.probability) * (last.value - first.value) >= 0.0

    def _run(self, value: float, share: float, level: float, nearby: Sequence[float] = ()) -> None:
        self.shares.append(share)
        self.trials.append(self.evaluate(value, share / sum(SHARES), len(self.trials), level, nearby))

    def _give_values(self, trial: Trial, keeps: bool) -> Iterator[float]:
        """Yield the values at which a trial shows that the bound is kept (or broken), the safest first."""
        nearby = [near for near in trial.nearby if near.value != trial.value]
        values: list[Trial | Nearby] = sorted([trial, *nearby], key=lambda near: near.value)
        for near in values if keeps == self.rising else reversed(values):
            if not (near.interval[1] < self.limit if keeps else near.interval[0] > self.limit):
                return
            yield near.value

    def _choose(self, share: float, level: float) -> float | None:
        keeping, broken = self.bracket()
        number, (low, high) = len(self.trials), (trial.value for trial in self.trials[:2])
        safe, unsafe = (low, high) if self.rising else (high, low)
        safe, unsafe = safe if keeping is None else keeping, unsafe if broken is None else broken
        if keeping is not None and broken is not None:
            if abs(keeping - broken) <= 0.02 * max(abs(keeping), abs(broken)):  # narrow enough
                return None
        elif safe == unsafe:  # the direction is not known yet
            safe, unsafe = low, high
        ends = sorted((_to_axis(safe, self.scaled), _to_axis(unsafe, self.scaled)))
        middle = 0.5 * (ends[0] + ends[1])
        line = self._fit()
        if line is None or number == 2:
            return _to_value(middle, self.scaled)
        root, slope = line
        # The half width of the next interval in log p: that of the last trial, at its own budget and level.
        last = self.trials[-1]
        width = math.log(last.interval[1] / max(last.result.probability, last.interval[1] / 100.0))
        width *= math.sqrt(self.shares[-1] / share)
        if number == _SEARCH_ESTIMATES:
            width *= normal_factor(level) / normal_factor(1.0 - self.alpha * _SEARCH_RISK / _SEARCH_ESTIMATES)
        side = (-1.0 if number % 2 or self._is_rare() else 1.0) * (1.0 if slope > 0 else -1.0)
        # distance from the root at which the next value is taken, in half widths of the interval there
        half_widths = 1.3
        least_slope = 1e-3
        point = root + side * half_widths * width / max(abs(slope), least_slope)
        inside = ends[0] < point < ends[1]
        return _to_value(point if inside else middle, self.scaled)

    def _inside(self, root: float) -> float:
        """Return the value of a root, or the middle of the rest where it lies outside."""
        known_ends = [end for end in self.bracket() if end is not None]
        ends = known_ends if len(known_ends) == 2 else [end.value for end in self.trials[:2]]
        low, high = sorted(_to_axis(end, self.scaled) for end in ends)
        return _to_value(root if low < root < high else 0.5 * (low + high), self.scaled)

    def _reach(self) -> float:
        """Return how far the failures near the root can be reweighed, along the axis of the search."""
        scored = [
            trial for trial in self.trials if trial.score is not None and trial.result.probability > 0.0
        ]
        if not scored:
            return 0.0
        nearest = min(scored, key=lambda trial: abs(math.log(trial.result.probability / self.limit)))
        assert nearest.score is not None
        reach = nearest.score.reach
        return min(reach / nearest.value, 1.0) if self.scaled else reach

    def _grid(self, value: float) -> list[float]:
        centre, reach = _to_axis(value, self.scaled), self._reach()
        if not reach:
            return []
        count = 12  # values on each side that a run is reweighed for
        steps, (low, high) = np.arange(-count, count + 1) / count, self.between
        values = (_to_value(centre + reach * step, self.scaled) for step in steps.tolist())
        return [point for point in values if low <= point <= high]  # others may not be valid

    def _fit(self) -> tuple[float, float] | None:
        """Return root and slope of a line through log p, which slopes of the trials help to find.

        log p bends: its slope may change by ``largest_bend`` of itself for each unit of log p, so that trials
        far from the bound tell less.
        """
        rows = [trial for trial in self.trials if 0.0 < trial.result.probability < 1.0]
        if len(rows) < 2:
            return None
        x = np.array([_to_axis(trial.value, self.scaled) for trial in rows])
        y = np.array([math.log(trial.result.probability / self.limit) for trial in rows])
        spread = [
            math.log(trial.interval[1] / max(trial.interval[0], trial.interval[1] * 1e-4)) for trial in rows
        ]
        largest_bend = 0.3
        weight = 1.0 / (np.maximum(spread, 1e-3) ** 2 + (0.5 * largest_bend * y * y) ** 2)
        matrix = np.array([[weight.sum(), weight @ x], [weight @ x, weight @ (x * x)]])
        vector = np.array([weight @ y, weight @ (x * y)])
        factors = [trial.value if self.scaled else 1.0 for trial in rows]
        slopes = [abs(f * trial.score.slope) for f, trial in zip(factors, rows, strict=True) if trial.score]
        for factor, trial, distance in zip(factors, rows, y.tolist(), strict=True):
            if trial.score is not None:
                # standard errors in the width of an interval of the trials that search
                standard_errors = 6.0
                error = standard_errors * factor * trial.score.error
                precision = 1.0 / max(error**2 + (largest_bend * max(slopes) * distance) ** 2, 1e-12)
                matrix[1, 1] += precision
                vector[1] += precision * factor * trial.score.slope
        if np.linalg.det(matrix) <= 1e-12 * matrix[0, 0] * max(matrix[1, 1], 1e-300):
            return None
        height, slope = np.linalg.solve(matrix, vector).tolist()
        return (-height / slope, slope) if slope != 0.0 else None


def _find_direction(trials: Sequence[Trial]) -> bool | None:
    """Return whether p rises, from disjoint intervals; None without any, or where they contradict."""
    pairs = list(combinations(sorted(trials, key=lambda trial: trial.value), 2))
    rises = any(trial.interval[1] < other.interval[0] for trial, other in pairs)
    falls = any(trial.interval[0] > other.interval[1] for trial, other in pairs)
    return rises if rises != falls else None


def _doubts(trials: list[Trial], limit: float, rising: bool, keeping: float | None) -> tuple[str, ...]:
    ordered = sorted(trials, key=lambda trial: trial.value, reverse=not rising)
    doubts = []
    open_ended = keeping is not None and any(trial.interval[1] >= limit for trial in trials)
    if open_ended and _find_direction(trials) is None:
        doubts.append(
            "no two estimates lie apart in one direction, so that the probability "
            f"{'rises' if rising else 'falls'} with the parameter is a guess"
        )
    highest_low = 0.0
    for trial in ordered:
        if trial.interval[1] < highest_low:
            doubts.append(
                "the probability is not monotone in the parameter: it falls again towards "
                f"{trial.value:.4g}, so the answer holds for the values that were tried alone"
            )
            break
        highest_low = max(highest_low, trial.interval[0])
    ill = [trial for trial in trials if trial.result.health]
    if ill:
        doubts.append("some estimates have health warnings; the answer can be as wrong as they are")
    least = min(trials, key=lambda trial: trial.interval[1])
    if keeping is None and least.interval[0] < limit:
        need = f"by counting, {limit:g} takes some {math.ceil(least.interval[1] / limit):,} times as many"
        if any(0.0 < trial.result.probability < limit for trial in ill):
            need = "twice the budget may answer the warnings"
        doubts.append(
            f"the least that is shown is p < {least.interval[1]:.2g}, at {least.value:.4g}, with "
            f"{least.result.rollouts:,} rollouts; {need}"
        )
    return tuple(doubts)


def _to_axis(value: float, scaled: bool) -> float:
    return math.log(value) if scaled else value


def _to_value(point: float, scaled: bool) -> float:
    return math.exp(point) if scaled else point
