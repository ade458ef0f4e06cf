"""Savings: what a change to a stack does to its failures, on the same tapes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.tape_runs import Verdicts
from avrare.base.errors import UsageError
from avrare.base.number_format import describe_share, format_probability
from avrare.estimation.result import intervals
from avrare.estimation.result.intervals import Interval
from avrare.protocols import Bools


@dataclass(frozen=True)
class Saving:
    """Effect of making a part perfect, or of another change, on the same tapes.

    Attributes:
        name: What is made perfect, or changed.
        vanish: Share of the failures that pass with it.
        vanish_interval: Its interval.
        new: Probability of a rollout that fails only with it.
        new_interval: Its interval.
        saved: Share of the probability that it saves: ``vanish`` minus ``new`` over the estimate.
        saved_interval: Its interval; a negative end means that it may do harm.
    """

    name: str
    vanish: float
    vanish_interval: Interval
    new: float
    new_interval: Interval
    saved: float
    saved_interval: Interval

    def describe(self) -> str:
        """Describe its demonstrated effect on the failures."""
        low, high = self.saved_interval
        saves = _describe_share(self.vanish, self.vanish_interval)
        if self.new_interval[1] >= 1.0:
            return f"{saves}; new ones were not looked for"
        if low > 0.0:
            return _describe_share(self.saved, self.saved_interval)
        new = f"new ones {format_probability(self.new, 2)}" if self.new else "no new ones were seen"
        new += f", at most {format_probability(self.new_interval[1], 2)}"
        times = f"failures {1.0 - self.saved:.2g} times as likely"
        if high < 0.0:
            return f"makes {times}, at least {1.0 - high:.2g} times: {saves}; {new}"
        return f"may make {times}: {saves}; {new}" if self.saved < 0.0 else f"{saves}; {new}"


def _describe_share(share: float, interval: Interval) -> str:
    least, most = interval
    least_share = 0.05  # least share of the failures that is a reason for a change
    worth = least > least_share
    bound = f"at least {describe_share(least)}" if worth else f"at most {describe_share(most)}"
    if share == (1.0 if worth else 0.0):
        return f"saves {bound} of them"
    return f"saves {describe_share(share)} of them, {bound}"


def measure_share(
    sample: FailureSample, chosen: Bools, broken: Bools, name: str, confidence: float | None = None
) -> tuple[float, Interval]:
    """Return the share of the failures that are ``chosen`` (F,), with its interval.

    Those whose rollouts are ``broken`` (F,) are left out; each end counts them against itself.

    Raises:
        UsageError: All are broken; ``name`` describes the rollouts.
    """
    if broken.all():
        text = f"{sample.size} of {sample.size} rollouts with {name} broke down"
        raise UsageError(text, "mend it: `avrare run` of that scenario shows the errors, or leave it out")
    if not broken.any():
        return sample.share_interval(chosen, confidence)
    share, _ = sample.take(np.flatnonzero(~broken)).share_interval(chosen[~broken])
    _, (low, _) = sample.share_interval(chosen & ~broken, confidence)
    _, (_, high) = sample.share_interval(chosen | broken, confidence)
    return share, (low, high)


def measure_saving(
    sample: FailureSample, name: str, stored: Verdicts, base: Verdicts, now: Verdicts
) -> Saving:
    """Measure what making a part perfect saves.

    Args:
        sample: The failures.
        name: Name of the perfect part.
        stored: Outcomes of the failing tapes with it.
        base: Outcomes of fresh tapes without it.
        now: Outcomes of the same fresh tapes with it.
    """
    # A third of the risk goes to each of the two shares and the estimate that divides one of them.
    level = 1.0 - (1.0 - sample.confidence) / 3.0
    vanish, vanish_interval = measure_share(sample, stored.passes, stored.broken, name)
    _, (low, high) = measure_share(sample, stored.passes, stored.broken, name, level)
    _, (p_low, p_high) = replace(sample, confidence=level).part_interval(np.ones(sample.size, dtype=bool))
    if sample.opened_at is not None:  # nothing is known of the failures that the estimate may have missed
        met = sample.probability / p_high
        low, high = low * met, 1.0 - (1.0 - high) * met
    fresh, lost = len(base.fails), int((base.broken | now.broken).sum())
    if lost == fresh:
        return Saving(name, vanish, vanish_interval, 0.0, (0.0, 1.0), 0.0, (-np.inf, high))
    count = int((now.fails & base.passes).sum())
    new, interval = count / (fresh - lost), intervals.clopper_pearson(count, fresh, sample.confidence, lost)
    new_low, new_high = intervals.clopper_pearson(count, fresh, level, lost)
    most = new_high / p_low if p_low else np.inf
    saved = vanish - new / sample.probability
    return Saving(name, vanish, vanish_interval, new, interval, saved, (low - most, high - new_low / p_high))
