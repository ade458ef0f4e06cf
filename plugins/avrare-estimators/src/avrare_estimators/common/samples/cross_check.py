"""Cross-check: nested levels estimate the probability of a long tape on their own.

A proposal that misses failures gives a sample that looks well: every row that it has drawn has a decent
weight. The missing ones show only to a method that does not use the proposal. Nested levels with Markov
chains (those of ``ess``) start at the rows drawn from the target, climb the score, and end at failures; the
weighted estimate must agree with their probability.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from avrare.protocols import Floats
from avrare.rollout.request import Integers, Request, Rollouts
from avrare_estimators.common.chains.kernel import Points
from avrare_estimators.common.chains.level_pass import LevelPass, PassShape
from avrare_estimators.common.chains.pcn import PcnKernel
from avrare_estimators.common.samples.sampling import Sample, failing_weights
from avrare_estimators.common.samples.sources import Source

CLIMB_TAPES = 5
"""Tapes of each sample of a group at the peak."""
GROUPS = 8
"""Independent groups of chains, whose scatter gives the uncertainty."""
_LENGTH, _SHARE = 6, 1.0 / 6.0
_FEWEST_CHAINS, _ENOUGH_CHAINS = 8, 26
"""Chains of a group, the fewest that climb and those whose answer is mostly exact enough to vouch."""
_SPARE_LEVELS = 0.5
"""Levels that a group may go further down than the estimate."""
_SMALLEST_PROBABILITY = 1e-18
_STAGE, _STAGES_OF_RUN = 2**30, 2**24


@dataclass(frozen=True)
class CrossCheckResult:
    """Outcome of a cross-check.

    Attributes:
        probabilities: Failure probability by each group alone, 0 where it died out; empty where the groups
            did not reach failure within their rollouts.
        rollouts: Its cost.
    """

    probabilities: tuple[float, ...]
    rollouts: int

    @property
    def mean(self) -> float:
        """Estimate of the failure probability."""
        return float(np.mean(self.probabilities))

    def variance(self, unit: float) -> float:
        """Return the variance of the mean in units of ``unit``."""
        return float((np.array(self.probabilities) / unit).var(ddof=1)) / len(self.probabilities)


@dataclass(frozen=True)
class CrossCheck:
    """Groups of chains of the target on their way to failure.

    Attributes:
        source: The proposal of the sample to compare with, which makes the requests.
        climb: The chains.
        budget: Rollouts left for them.
        rollouts: Rollouts done.
        pending: The rollouts asked for.
    """

    source: Source
    climb: LevelPass
    budget: int
    rollouts: int = 0
    pending: Request | None = None

    @staticmethod
    def begin(samples: Sequence[Sample], budget: int, most: int) -> CrossCheck | None:
        """Begin the cross-check of the last of a run's samples.

        Args:
            samples: All samples of the run; the chains start at their target rows.
            budget: Rollouts to spend.
            most: Tapes of all chains together that fit into memory.

        Returns:
            None where there is nothing to compare with, or too little to climb with.
        """
        sample = samples[-1]
        estimate, places = float(failing_weights(sample).mean()), _target_places(samples)
        chains = _most_chains(budget, sum(map(len, places)), estimate, most) if estimate > 0.0 else 0
        if not chains:
            return None
        # Each group starts at the best of its share of the target's rows.
        stage = (_STAGE + sample.strata[0].run * _STAGES_OF_RUN) % 2**32
        shape = PassShape(
            runs=GROUPS,
            chains=chains,
            length=_LENGTH,
            skip=0,
            survivors=chains,
            floor=_SMALLEST_PROBABILITY,
            stage=stage,
        )
        starts, shares = _choose_starts(samples, places, shape.samples)
        climb = LevelPass.begin_from(sample.strata[0].plan, shape, PcnKernel(), starts, shares)
        return CrossCheck(sample.source, climb, budget)._continue()

    def tell(self, rollouts: Rollouts) -> CrossCheck:
        """Continue the climb. The chains follow the target: weights of the proposal play no part."""
        plain = replace(rollouts, log_weight=np.zeros(len(rollouts.error)))
        done = self.rollouts + len(rollouts.error)
        return replace(self, climb=self.climb.tell(plain), rollouts=done, pending=None)._continue()

    def _continue(self) -> CrossCheck:
        proposal = self.climb.proposal
        if proposal is None:
            return replace(self, climb=self.climb.without_tapes())
        if len(proposal) > self.budget:
            return self
        request = self.source.replay(proposal)
        return replace(self, pending=request, budget=self.budget - len(proposal))

    def result(self) -> CrossCheckResult:
        """Return the outcome."""
        reached = self.climb.proposal is None
        return CrossCheckResult(tuple(map(float, self.climb.probabilities)) if reached else (), self.rollouts)


def rollouts_to_vouch(samples: Sequence[Sample]) -> int:
    """Return the rollouts with which a cross-check mostly confirms a correct estimate of the last sample."""
    estimate = float(failing_weights(samples[-1]).mean())
    rows = sum(map(len, _target_places(samples)))
    if not estimate or not rows:
        return 0
    return math.ceil(_levels(_ENOUGH_CHAINS, rows, estimate) * GROUPS * _ENOUGH_CHAINS * (_LENGTH - 1))


def _target_places(samples: Sequence[Sample]) -> list[Integers]:
    """Return the places of the rows drawn from the target that have not broken down."""
    return [np.flatnonzero(~sample.error[: sample.target_rows]) for sample in samples]


def _most_chains(budget: int, rows: int, estimate: float, most: int) -> int:
    """Return the most chains of a group that can climb to ``estimate`` within the budget; 0 if too few.

    Their tapes are at most ``most``.
    """
    for chains in range(min(rows, most) // (GROUPS * _LENGTH), _FEWEST_CHAINS - 1, -1):
        if _levels(chains, rows, estimate) * GROUPS * chains * (_LENGTH - 1) <= budget:
            return chains
    return 0


def _levels(chains: int, rows: int, estimate: float) -> float:
    """Return the levels from the best of the target's rows down to the estimate, or a little below it."""
    levels = math.log(chains * GROUPS * _LENGTH / rows / estimate) / -math.log(_SHARE)
    return max(0.0, levels + _SPARE_LEVELS)


def _choose_starts(samples: Sequence[Sample], places: Sequence[Integers], size: int) -> tuple[Points, Floats]:
    """Return ``size`` starts of each group, and the share of its rows that they stand for."""
    pairs = list(zip(samples, places, strict=True))
    score = np.concatenate([sample.score[rows] for sample, rows in pairs])
    violated = np.concatenate([sample.violated[rows] for sample, rows in pairs])
    robustness = np.concatenate([sample.robustness[rows] for sample, rows in pairs])
    key = np.where(violated, np.inf, score)
    chosen, shares = [], []
    for group in range(GROUPS):
        places_of_group = np.arange(group, len(key), GROUPS)
        best, share = _best(key[places_of_group], size)
        chosen.append(places_of_group[best])
        shares.append(share)
    rows = np.concatenate(chosen)
    ends = np.cumsum([0, *map(len, places)])
    tapes = np.empty((len(rows), *samples[0].tapes(places[0][:0]).shape[1:]))
    for begin, sample, target_rows in zip(ends, samples, places, strict=False):
        here = (rows >= begin) & (rows < begin + len(target_rows))
        tapes[here] = sample.tapes(target_rows[rows[here] - begin])
    root = np.tile(np.arange(size), GROUPS)
    points = Points(tapes, score[rows], violated[rows], robustness[rows], root, np.zeros(len(rows)))
    return points, np.array(shares)


def _best(key: Floats, size: int) -> tuple[Integers, float]:
    """Return ``size`` places above the largest level that so many pass, and the share of all that pass it."""
    cut = np.sort(key)[-size - 1] if len(key) > size else -np.inf
    above = np.flatnonzero(key > cut) if cut < np.inf else np.flatnonzero(key == np.inf)
    if not len(above):  # all tie
        return np.arange(size), 1.0
    return np.resize(above, size), len(above) / len(key)
