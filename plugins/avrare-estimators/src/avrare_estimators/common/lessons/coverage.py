"""Mode coverage: what the stages of learning know against the sample that counts.

They must agree with it, and its proposal must reach the failures that they have met.
A failure whose p/q is near its bound 1 / a0, with a0 the share of the target, is drawn by the target's rows
alone: it belongs to a mode that the proposal does not cover. A sample of usual size may hold none of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from avrare.base.number_format import format_probability
from avrare.base.special_functions import t_factor
from avrare_estimators.common import health
from avrare_estimators.common.lessons.lessons import Lessons, ratios_of
from avrare_estimators.common.samples.sampling import Sample
from avrare_estimators.common.samples.sources import TapeSource
from avrare_estimators.common.weights import effective_size, stratified_variance

_NEAR = 0.5
"""Share of the bound from which a failure counts as uncovered."""
_MOST_UNCOVERED = 0.15
_LEAST_EFFECTIVE = 15.0
_RISK = 1e-3
"""Probability that stages which agree seem not to."""


def find_coverage_doubts(lessons: Lessons, final: Sample) -> dict[str, str]:
    """Return the warnings that the stages of learning contradict the final sample, or know more than it.

    Args:
        lessons: The stages; without any there is nothing to say.
        final: The sample that counts.
    """
    source = final.source
    assert isinstance(source, TapeSource)
    if not lessons.samples or source.mixture is None:
        return {}
    found: dict[str, str] = {}
    share = _uncovered(lessons, final)
    if share > _MOST_UNCOVERED:
        text = "of the failures that learning has met are hardly likelier under the proposal"
        found |= health.warn("unchecked", reason=f"{share:.0%} {text}")
    if differing := _disagreeing(lessons.samples, final):
        found |= health.warn("contradicted", reason=f"stages of learning estimate {differing}")
    return found


def _uncovered(lessons: Lessons, final: Sample) -> float:
    """Return the share of the failures' probability that only the target's rows draw."""
    violated = lessons.violated
    if not violated.any():
        return 0.0
    assert isinstance(final.source, TapeSource)
    assert final.source.mixture is not None
    mixture = final.source.mixture
    ratios = np.concatenate([ratios_of(sample, mixture) for sample in lessons.samples])
    weights = lessons.weights[violated]
    uncovered = lessons.bounded(ratios[violated]) > _NEAR / lessons.defensive
    return float(weights[uncovered].sum() / weights.sum())


def _disagreeing(samples: Sequence[Sample], final: Sample) -> str:
    mean, variance, _ = _estimate(final)
    return find_differing(samples, mean, variance)


def find_differing(samples: Sequence[Sample], mean: float, variance: float) -> str:
    """Return the estimates of stages that the final one contradicts, as text; "" where there are none.

    Args:
        samples: Samples of the stages.
        mean: Final estimate.
        variance: Its relative variance.
    """
    known = [one for sample in samples if (one := _estimate(sample))[2] >= _LEAST_EFFECTIVE]
    if not known or not mean:
        return ""
    confidence = 1.0 - _RISK / len(known)
    apart = [
        format_probability(value)
        for value, spread, effective in known
        if abs(math.log(value / mean))
        > t_factor(confidence, int(effective) - 1) * math.sqrt(math.log1p(spread) + math.log1p(variance))
    ]
    return f"{', '.join(apart)} but {format_probability(mean)}" if apart else ""


def _estimate(sample: Sample) -> tuple[float, float, float]:
    """Return a sample's estimate, its relative variance, and its effective number of failures."""
    values = np.where(sample.violated, np.exp(sample.log_weights), 0.0)
    mean = float(values.mean())
    if not mean:
        return 0.0, math.inf, 0.0
    return mean, stratified_variance(values / mean, sample.target_rows), effective_size(values)
