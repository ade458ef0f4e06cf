"""Looks and growth: how many runs an estimate takes, and how large they are.

Both are fixed before the runs that count begin, by options and by a pilot that does not count: the mean of
the runs stays unbiased.

An estimate that may stop at one of several looks, at each with an interval of its own, misses the truth at
most as often as all of these intervals together (Bonferroni). It may therefore stop by any rule. Here it
stops by the scatter of its runs, which leans towards samples that have missed their tail: an interval at the
full confidence would then cover too seldom (docs/statistics.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

from avrare.estimation.plan.plan import CostForecast
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.note import Note, describe_missed_goal, describe_precision
from avrare_estimators.common import health

LEAST_RUNS = 10
"""Runs that must remain after a pilot or growth: the pilot then costs a tenth, and the interval stands."""
WANTED_ROOTS = 24
"""Roots aimed at; the warning ``few_roots`` begins at 15, and a pilot's number scatters."""
MOST_GROWTH = 8
LIKELY, RARE = 1e-2, 1e-6
"""Probabilities for which the cost is forecast, until the pilot knows better."""
HOPELESS_GROWTH = 2
"""Growth where even the largest one promises too few roots: more would be paid for another warning."""


@dataclass(frozen=True)
class Looks:
    """Numbers of runs at which an estimate may stop.

    Attributes:
        runs: Increasing; the last is the cap. A single one: the number of runs is fixed.
        goal: Relative error to stop at; None: only the cap ends the estimate.
    """

    runs: tuple[int, ...]
    goal: float | None = None

    @staticmethod
    def until(goal: float | None, first: int, most: int) -> Looks:
        """Plan looks that double, from ``first`` runs or a few more up to ``most``; one without a goal."""
        if goal is None:
            return Looks((most,))
        halvings = max(0, math.floor(math.log2(most / first))) if most > first else 0
        return Looks(tuple(math.ceil(most / 2**k) for k in range(halvings, -1, -1)), goal)

    def missing(self, done: int, relative_error: Callable[[], float]) -> int:
        """Return how many more runs are wanted after ``done``; 0: stop."""
        if done >= self.runs[-1] or (done in self.runs and self._reaches_goal(relative_error())):
            return 0
        return next(look for look in self.runs if look > done) - done

    def share(self, done: int) -> float:
        """Return the share of the error that the look at ``done`` runs may take.

        The first takes half of the error, the next a quarter, and so on; the last takes what is left.
        """
        return 0.5 ** min(self.runs.index(done) + 1, len(self.runs) - 1)

    def interval(self, done: int, interval_at: Callable[[float], Interval]) -> Callable[[float], Interval]:
        """Return the interval that holds at all looks together, of runs that stopped at ``done``."""
        share = self.share(done)
        return interval_at if share == 1.0 else partial(_widen, interval_at, share)

    def diagnostics(self, relative_error: float) -> dict[str, object]:
        """Return the looks, and whether the goal was reached; empty without a goal."""
        if self.goal is None:
            return {}
        return {"looks": list(self.runs), "goal_reached": self._reaches_goal(relative_error)}

    def notes(self, rollouts: int, probability: float, relative_error: float) -> tuple[Note, ...]:
        """Return the note on an estimate that missed its goal; empty if it reached the goal."""
        if self.goal is None or self._reaches_goal(relative_error):
            return ()
        progress = describe_precision(probability, relative_error)
        return (describe_missed_goal(rollouts, progress, "most_runs"),)

    def _reaches_goal(self, relative_error: float) -> bool:
        return self.goal is not None and relative_error <= self.goal


def _widen(interval_at: Callable[[float], Interval], share: float, confidence: float) -> Interval:
    return interval_at(1.0 - share * (1.0 - confidence))


@dataclass(frozen=True)
class Pilot:
    """Findings of a pilot, and the size of the runs that follows from them.

    Attributes:
        rollouts: Its rollouts.
        roots: Roots that runs of the given size would end with; 0 where the pilot found no failure.
        relative_variance: Relative variance of one such run; NaN where unknown.
        growth: Factor by which the runs that count are larger.
        cost: Cost of a run of the given size.
    """

    rollouts: int
    roots: float
    relative_variance: float
    growth: int = 1
    cost: float = 0.0

    @property
    def wanted_growth(self) -> int:
        """Factor that gives the wanted number of roots, which grows with the size of a run."""
        if self.hopeless:
            return HOPELESS_GROWTH
        return min(MOST_GROWTH, math.ceil(WANTED_ROOTS / max(self.roots, 1.0)))

    @property
    def hopeless(self) -> bool:
        """True where few roots are expected even of the largest runs."""
        return MOST_GROWTH * self.roots < health.FEWEST_ROOTS

    def first_look(self, goal: float, least: int, most: int) -> int:
        """Return half of the runs that a relative error is likely to need, within bounds."""
        if not math.isfinite(self.relative_variance):
            return min(least, most)
        return min(most, max(least, math.ceil(self.relative_variance / self.growth / goal**2 / 2.0)))

    def forecast(
        self,
        kind: Literal["rollouts", "steps"],
        looks: Looks,
        done: int,
        spent: float = 0.0,
        pilots: float = 0.0,
    ) -> CostForecast:
        """Return the cost of an estimate that has begun ``done`` runs.

        ``spent`` went before all runs; ``pilots`` is the cost of the pilot of each run.
        """
        run = pilots + self.growth * self.cost
        next_look = next((look for look in looks.runs if look >= done), done)
        least, most = (spent + runs * run for runs in (next_look, max(looks.runs[-1], done)))
        return CostForecast(kind, least, most, "by the pilot")

    def diagnostics(self, size: int, name: str) -> dict[str, object]:
        """Return the roots that the pilot promises, and the ``size`` of the runs: particles or chains."""
        return {"pilot_roots": self.roots, name: size}

    def notes(self, size: int, name: str) -> tuple[Note, ...]:
        """Return the note on runs whose size was raised to ``size`` particles or chains; none otherwise."""
        if self.growth == 1:
            return ()
        text = (
            f"A pilot, which does not count, promised {self.roots:.0f} roots a run: the runs that count have "
            f"{size} {name} in place of {size // self.growth}."
        )
        if self.hopeless:
            text += (
                f" Few roots are expected, and {name} were not raised further: give {name}, a score that "
                "rises earlier on the way to a failure, or another estimator."
            )
        return (Note("pilot", text),)
