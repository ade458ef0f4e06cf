"""Entry level: how near to failure a weighted sample goes before Markov chains take over.

A weighted sample reaches a level ever less exactly the rarer it is, above all by what its proposal does not
cover. Chains that start above a level lead to the more unlike ends the farther failure is: few of the rows
that have entered have offspring that fails. The best level has the least sum of both costs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from avrare.protocols import Floats
from avrare.rollout.request import Integers
from avrare_estimators.common.lessons.lessons import LEAST_ELITE, Lessons, ratios_of
from avrare_estimators.common.tapes.tape_mixture import TapeMixture

LENGTH = 10
"""Samples of a chain at a level, of which a tenth lies above the next level."""
_PER_DECADE = 4.8
"""Mean square of the offspring of a start over its squared mean, for each factor of ten in probability.

Half of what is above 1 is taken as the start's own, and half as the chance of its chain.
"""


@dataclass(frozen=True)
class Entry:
    """Level at which a weighted sample hands over to chains.

    Attributes:
        level: Score above which a rollout has entered; infinity: only failures have, and chains have no part.
        probability: Estimated probability to enter.
        variance: Relative variance of one row of the sample, with what it may not cover.
        mixture: Proposal of the sample; None: the target.
    """

    level: float
    probability: float
    variance: float
    mixture: TapeMixture | None

    @property
    def climbs(self) -> bool:
        """Chains go on from here."""
        return self.level < math.inf

    def cost(self, probability: float) -> float:
        """Return the expected relative variance times rollouts of an estimate of ``probability``."""
        decades = max(math.log10(self.probability / probability), 0.0)
        half = (_PER_DECADE**decades - 1.0) / 2.0
        return climb_cost(self.variance, half, half, max(decades, 1.0) * (LENGTH - 1))


def climb_cost(variance: float, lasting: float, chance: float, moves: float) -> float:
    """Return the relative variance times rollouts of sample and chains, the work divided as is best.

    Args:
        variance: Relative variance of one row of the sample, for the probability to enter.
        lasting: Relative variance of the offspring of a start that is the start's own.
        chance: Relative variance that one chain adds.
        moves: Rollouts of a chain.
    """
    return (math.sqrt(start_variance(variance, lasting)) + math.sqrt(chance * moves)) ** 2


def start_variance(variance: float, lasting: float) -> float:
    """Return the relative variance of one row of the sample, for the probability to fail."""
    return variance + (variance + 1.0) * lasting


def best_entry(lessons: Lessons) -> Entry | None:
    """Return the entry of the least cost, from the target or the newest proposal; None without any."""
    mixtures = [None, lessons.final()] if lessons.mixtures else [None]
    found = [one for mixture in mixtures for one in _entries(lessons, mixture)]
    known = lessons.guessed_probability
    return min(found, key=lambda one: one.cost(known), default=None)


def _entries(lessons: Lessons, mixture: TapeMixture | None) -> list[Entry]:
    """Return the entries for a sample from ``mixture``.

    Only levels are considered above which the lessons have an effective number of ``LEAST_ELITE`` rows. As
    many rows do not show what is rarer than one of them: that much may be uncovered, with the largest weight
    1 / a0.
    """
    key, weights = lessons.key, lessons.weights
    order = np.argsort(-key, kind="stable")
    key, weights, rows = key[order], weights[order], len(key)
    bounded = np.ones(rows)
    if mixture is not None:
        ratios = np.concatenate([ratios_of(sample, mixture) for sample in lessons.samples])
        bounded = lessons.bounded(ratios)[order]
    total, squares = np.cumsum(weights), np.cumsum(weights**2)
    effective = total**2 / np.maximum(squares, 1e-300)
    probability = total / rows
    covered = np.cumsum(weights * bounded) / np.maximum(total, 1e-300)
    uncovered = 1.0 / (lessons.defensive * effective) if mixture is not None else 0.0
    variance = np.maximum((covered + uncovered) / probability - 1.0, 0.0)
    # Rows above a level are those before a place where the score falls.
    cuts = np.flatnonzero((key[:-1] > key[1:]) & (effective[:-1] >= LEAST_ELITE) & np.isfinite(key[1:]))
    return [_entry(int(cut), key, probability, variance, mixture) for cut in _thinned(cuts, probability)]


def _entry(
    cut: int, key: Floats, probability: Floats, variance: Floats, mixture: TapeMixture | None
) -> Entry:
    level = math.inf if key[cut] == math.inf else float(key[cut + 1])
    return Entry(level, float(probability[cut]), float(variance[cut]), mixture)


def _thinned(cuts: Integers, probability: Floats) -> Integers:
    """Return the first of the cuts, and those at which the probability has grown by a tenth each time."""
    steps = np.floor(np.log(probability[cuts]) / math.log(1.1))
    return cuts[np.unique(steps, return_index=True)[1]]
