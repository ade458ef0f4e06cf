"""Rules of ``auto``: what a pilot's failures say about the estimator to use. All are fixed before it runs.

The pilot never counts in an estimate, and no rule compares estimates: the estimate of whatever is chosen is
as unbiased as without the choice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from avrare.base.number_format import format_percent
from avrare.estimation.monte_carlo.counts import round_to_two_digits
from avrare.estimation.result.fresh_rows import FreshRows

GOAL = 0.2
"""Relative error aimed at where nothing is given."""
ROLLOUTS = 50_000
"""Most rollouts where nothing is given."""
PILOT = 3000
"""Most rollouts of the pilot, and of the pilot from which a proposal is learned."""
_SHARE = 15
"""Share of a budget of rollouts: the pilot takes at most 1 / 15 of it, and learning in vain twice as much."""
FIRST_SHARE = 0.7
"""Share of the remaining budget that a first witness may take."""
FEW_FAILURES = 2.0
"""Failures below which Monte Carlo, as a second witness, would say too little."""
LEAST_SECOND = 5000
"""Rollouts below which a second witness would say too little."""
_LEAST = 5000
"""Rollouts below which the pilot and learning would find too little: Monte Carlo takes them all."""
_TIMES = 5
"""Learning is tried where Monte Carlo would cost this many times as much as learning without success."""
_VAIN = 0.3
"""Largest share of Monte Carlo's cost that an unsuccessful choice may take."""
_VAIN_OF_ALL, _VAIN_OF_SPENT = 0.34, 0.6
"""Largest share of all rollouts that it may take; where all are spent, learning that fails leaves a trial."""
_ENOUGH = 100
"""Failures that make Monte Carlo exact enough where rollouts are spent: a relative error of 10 %."""
_GAIN = 3.0
"""Gain over Monte Carlo that a trial of another estimator must promise."""
_DOUBT = 2.0
"""Factor by which the variance of a single run, and so of a trial, may be too small."""


@dataclass(frozen=True)
class Aim:
    """Goal of an estimate, and the most that it may cost.

    Attributes:
        goal: Relative error to reach; None: the rollouts are spent.
        rollouts: Most rollouts of a specification, pilot and learning included.
    """

    goal: float | None
    rollouts: float

    @property
    def small(self) -> bool:
        """Too few rollouts to choose anything but Monte Carlo."""
        return self.rollouts < _LEAST

    @property
    def pilot(self) -> int:
        """Most rollouts of the pilot."""
        return min(PILOT, int(self.rollouts / _SHARE))

    @property
    def failures(self) -> int:
        """Failures of a specification that end its pilot: a fifth of those that Monte Carlo will need."""
        needed = _ENOUGH if self.goal is None else self.goal**-2
        return min(10, max(3, round(needed / 5)))

    def estimate_need(self, evidence: FreshRows) -> float:
        """Return the rollouts that Monte Carlo is expected to need.

        A pilot that ended before its failures gets one more: too few are likelier than too many.
        """
        needed_failures = _ENOUGH if self.goal is None else self.goal**-2 + 2.0
        return (
            needed_failures
            * evidence.rows
            / max(evidence.failures, min(evidence.failures + 1, self.failures))
        )

    def is_frequent(self, evidence: FreshRows) -> bool:
        """Return whether Monte Carlo is the estimator: nothing can pay for the attempt to learn."""
        if self.goal is None:
            return self.estimate_need(evidence) <= self.rollouts
        return self.estimate_need(evidence) <= _TIMES * 2 * self.pilot

    def may_try(self, cost: float, evidence: FreshRows) -> bool:
        """Return whether a choice may cost these rollouts even if all of them turn out useless."""
        if self.goal is None:
            return cost <= _VAIN_OF_SPENT * self.rollouts
        return cost <= min(_VAIN * self.estimate_need(evidence), _VAIN_OF_ALL * self.rollouts)

    def describe(self, evidence: FreshRows) -> str:
        """Describe the failures of the pilot, and the rollouts that Monte Carlo would need after it."""
        failures = f"{evidence.failures:,} failures" if evidence.failures != 1 else "1 failure"
        at_least = "" if evidence.failures else "at least "
        error = format_percent(0.1 if self.goal is None else self.goal)
        return (
            f"{failures} in {evidence.rows:,} rollouts of the pilot, so Monte Carlo needs {at_least}about "
            f"{round_to_two_digits(self.estimate_need(evidence)):,} rollouts for a relative error of {error}"
        )


def forecast_gain(evidence: FreshRows, probability: float, relative_error: float, cost: float) -> float:
    """Return the gain over Monte Carlo that a trial promises, at its pessimistic end; 0 if it failed.

    Args:
        evidence: The pilot's.
        probability: Estimate of the trial.
        relative_error: Its relative error.
        cost: Its rollouts.
    """
    if not probability > 0.0 or not math.isfinite(relative_error):
        return 0.0
    frequent = max(probability, evidence.failures / evidence.rows)
    return (1.0 - frequent) / frequent / (_DOUBT * max(relative_error, 1e-6) ** 2 * cost)


def pays(gain: float) -> bool:
    """Return whether a promised gain is large enough to leave Monte Carlo."""
    return gain >= _GAIN
