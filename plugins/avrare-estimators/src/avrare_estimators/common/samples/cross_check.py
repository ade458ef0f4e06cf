"""Cross-check: nested levels estimate the probability on their own, and weigh the failures that they find.

A proposal that misses failures gives a sample that looks well: every row that it has drawn has a decent
weight. The missing ones show only to a method that does not use the proposal. Nested levels with Markov
chains (those of ``ess``) start at the rows drawn from the target, climb the score, and end at failures. The
weighted estimate must agree with their probability, and their failures must have weights that the sample
knows.

Both may miss a rare mode. The proposal's rows, which are many, may yet hold a failure of it: one whose weight
is large among theirs. Scouts start from the heaviest failures and move as failures of the target do; if they
come to weights that the climb does not know, it has missed something too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from avrare.protocols import Floats
from avrare.rollout.request import Integers, Request, Rollouts
from avrare_estimators.common.chains.kernel import Points, rotated
from avrare_estimators.common.chains.level_pass import LevelPass, PassShape
from avrare_estimators.common.chains.pcn import PcnKernel
from avrare_estimators.common.samples.sampling import Sample
from avrare_estimators.common.weights import mixture_log_weights

CLIMB_TAPES = 5
"""Tapes of each sample of a group at the peak."""
GROUPS = 8
"""Independent groups of chains, whose scatter gives the uncertainty."""
_LENGTH, _SHARE = 10, 0.1
_FEWEST_CHAINS, _ENOUGH_CHAINS = 5, 16
"""Chains of a group, the fewest that climb and those whose answer is mostly exact enough to vouch."""
_WEIGHED = 25
"""Failures of a group whose weight is computed."""
_SCOUTS, _ROUNDS, _ANGLE = 24, 30, 0.4
"""Scouts, their steps, and the size of a step [rad]."""
_EXCESS = 3.0
"""Logarithm of a weight over the sample's largest that no honest sample shows: there it is below 2."""
_FLOOR = 1e-18
_STAGE, _STAGES_OF_RUN = 2**30, 2**24


@dataclass(frozen=True)
class CrossCheckResult:
    """Outcome of a cross-check.

    Attributes:
        probabilities: Failure probability by each group alone; 0 where it died out.
        unseen: Share of each group's failures whose weight is above all of the sample's.
        lost_scouts: Number of scouts with weights far above the sample's, where no group's failure has such.
        roots: Number of target rows that the failures descend from.
        rollouts: What it has cost.
    """

    probabilities: tuple[float, ...]
    unseen: tuple[float, ...]
    lost_scouts: int
    roots: int
    rollouts: int


@dataclass(frozen=True)
class CrossCheck:
    """Groups of chains of the target on their way to failure.

    Attributes:
        sample: The sample to compare with.
        largest: Logarithm of the largest weight that it knows.
        climb: The chains.
        budget: Rollouts left for the chains.
        scouts: (S, steps + 1, noise_size) failures on their way.
        rounds: Steps that the scouts have done.
        rollouts: Rollouts done.
        pending: The rollouts asked for.
        found: (F,) places of the failures that are being weighed.
        log_ratio: (F + S,) log p/q of these and of the scouts; None before.
    """

    sample: Sample
    largest: float
    climb: LevelPass
    budget: int
    scouts: Floats
    rounds: int = 0
    rollouts: int = 0
    pending: Request | None = None
    found: Integers | None = None
    log_ratio: Floats | None = None

    @staticmethod
    def begin(
        samples: Sequence[Sample],
        budget: int,
        most: int,
        estimate: float | None = None,
        level: float = math.inf,
    ) -> CrossCheck | None:
        """Begin the cross-check of the last of a run's samples.

        Args:
            samples: All samples of the run; the chains start at their target rows.
            budget: Rollouts to spend.
            most: Tapes of all chains together that fit into memory.
            estimate: Probability to check; None: that of the last sample.
            level: Score above which rows are known, besides those that fail.

        Returns:
            None where there is nothing to compare with, or too little to climb with.
        """
        sample = samples[-1]
        estimate = _estimate(sample) if estimate is None else estimate
        places = _target_places(samples)
        scouts = _heaviest_failures(samples)
        budget -= GROUPS * _WEIGHED + len(scouts) * (_ROUNDS + 1)
        chains = _most_chains(budget, sum(map(len, places)), estimate, most) if estimate > 0.0 else 0
        if not chains:
            return None
        # 1. Each group starts at the best of its share of the target's rows.
        shape = PassShape(GROUPS, chains, _LENGTH, 0, chains, _FLOOR, _first_stage(sample))
        starts, shares = _choose_starts(samples, places, shape.samples)
        climb = LevelPass.begin_from(sample.strata[0].plan, shape, PcnKernel(), starts, shares)
        largest = float(sample.log_weights[sample.reaching(level).violated].max())
        return CrossCheck(sample, largest, climb, budget, scouts)._continue()

    def tell(self, rollouts: Rollouts) -> CrossCheck:
        """Continue the climb, or end with the weights of the failures."""
        assert self.pending is not None
        done = replace(self, rollouts=self.rollouts + len(rollouts.error), pending=None)
        if self.found is not None:
            return replace(done, log_ratio=self.sample.source.log_ratio(self.pending, rollouts))
        if self.rounds < _ROUNDS and len(self.scouts):
            failed = rollouts.violated[:, 0, None, None]
            scouts = np.where(failed, self._scouts_moved(), self.scouts)
            return replace(done, scouts=scouts, rounds=self.rounds + 1)._continue()
        # 3. The chains follow the target: weights of the proposal play no part.
        plain = replace(rollouts, log_weight=np.zeros(len(rollouts.error)))
        return replace(done, climb=self.climb.tell(plain))._continue()

    def _scouts_moved(self) -> Floats:
        target = self.sample.strata[0]
        stage = _first_stage(self.sample) + _STAGES_OF_RUN - 1 - self.rounds
        fresh = replace(target, stage=stage, first=0).normals(np.arange(len(self.scouts)))
        return rotated(self.scouts, fresh, np.full(len(fresh), _ANGLE))

    def _continue(self) -> CrossCheck:
        # 2. The scouts move among the failures of the target.
        if self.rounds < _ROUNDS and len(self.scouts):
            return replace(self, pending=self.sample.source.target_request(self._scouts_moved()))
        proposal = self.climb.proposal
        if proposal is None:
            return self._weigh()
        if len(proposal) > self.budget:
            return self
        request = self.sample.source.target_request(proposal)
        return replace(self, pending=request, budget=self.budget - len(proposal))

    def _weigh(self) -> CrossCheck:
        # 4. Compute the weights of the scouts and of some failures of each group.
        failed = self.climb.failed
        size = failed.shape[1]
        found = np.concatenate(
            [r * size + np.flatnonzero(row)[_spread(row.sum())] for r, row in enumerate(failed)]
        )
        if not len(found):
            return self
        tapes = np.concatenate([self.climb.points.tape[found], self.scouts])
        request = self.sample.source.target_request(tapes)
        return replace(self, found=found, pending=request)

    def result(self) -> CrossCheckResult | None:
        """Return the outcome; None where the chains did not reach failure within the budget."""
        if self.found is None or self.log_ratio is None:
            return None
        group = self.found // self.climb.shape.samples
        excess = mixture_log_weights(self.log_ratio, self.sample.share) - self.largest
        far = excess > _EXCESS
        above = np.bincount(group, excess[: len(group)] > 0.0, minlength=GROUPS)
        unseen = above / np.maximum(np.bincount(group, minlength=GROUPS), 1)
        roots = {(int(r), int(self.climb.points.root[i])) for r, i in zip(group, self.found, strict=True)}
        return CrossCheckResult(
            probabilities=tuple(map(float, self.climb.probabilities)),
            unseen=tuple(map(float, unseen)),
            lost_scouts=0 if far[: len(group)].any() else int(far.sum()),
            roots=len(roots),
            rollouts=self.rollouts,
        )


def rollouts_to_vouch(samples: Sequence[Sample], estimate: float | None = None) -> int:
    """Return the rollouts of a cross-check that mostly vouches for a right estimate.

    ``estimate``: None: that of the last sample.
    """
    estimate = _estimate(samples[-1]) if estimate is None else estimate
    rows = sum(map(len, _target_places(samples)))
    if not estimate or not rows:
        return 0
    climb = _levels(_ENOUGH_CHAINS, rows, estimate) * GROUPS * _ENOUGH_CHAINS * (_LENGTH - 1)
    return math.ceil(climb) + GROUPS * _WEIGHED + _SCOUTS * (_ROUNDS + 1)


def _estimate(sample: Sample) -> float:
    return float(np.where(sample.violated, np.exp(sample.log_weights), 0.0).mean())


def _target_places(samples: Sequence[Sample]) -> list[Integers]:
    """Return the places of the rows drawn from the target that have not broken down."""
    return [np.flatnonzero(~one.error[: one.target_rows]) for one in samples]


def _heaviest_failures(samples: Sequence[Sample]) -> Floats:
    """Return the tapes of the proposals' failures with the largest weights, some from each sample."""
    each, tapes = _SCOUTS // len(samples), [samples[0].tapes(np.arange(0))]
    for sample in samples:
        rows = np.flatnonzero(sample.violated)
        rows = rows[rows >= sample.target_rows] if sample.source.replayable else rows[:0]
        tapes.append(sample.tapes(rows[np.argsort(-sample.log_ratio[rows], kind="stable")][:each]))
    return np.concatenate(tapes)


def _most_chains(budget: int, rows: int, estimate: float, most: int) -> int:
    """Return the most chains of a group that can climb to ``estimate`` within the budget; 0 if too few.

    Their tapes are at most ``most``.
    """
    for chains in range(min(rows, most) // (GROUPS * _LENGTH), _FEWEST_CHAINS - 1, -1):
        if _levels(chains, rows, estimate) * GROUPS * chains * (_LENGTH - 1) <= budget:
            return chains
    return 0


def _levels(chains: int, rows: int, estimate: float) -> float:
    """Return the levels from the best of the target's rows down to the estimate."""
    return max(0.0, math.log(chains * GROUPS * _LENGTH / rows / estimate) / -math.log(_SHARE))


def _first_stage(sample: Sample) -> int:
    return (_STAGE + sample.strata[0].run * _STAGES_OF_RUN) % 2**32


def _choose_starts(samples: Sequence[Sample], places: Sequence[Integers], size: int) -> tuple[Points, Floats]:
    """Return ``size`` starts of each group, and the share of its rows that they stand for."""
    score = np.concatenate([one.score[rows] for one, rows in zip(samples, places, strict=True)])
    violated = np.concatenate([one.violated[rows] for one, rows in zip(samples, places, strict=True)])
    robustness = np.concatenate([one.robustness[rows] for one, rows in zip(samples, places, strict=True)])
    key = np.where(violated, np.inf, score)
    chosen, shares = [], []
    for group in range(GROUPS):
        mine = np.arange(group, len(key), GROUPS)
        best, share = _best(key[mine], size)
        chosen.append(mine[best])
        shares.append(share)
    rows = np.concatenate(chosen)
    ends = np.cumsum([0, *map(len, places)])
    tapes = np.empty((len(rows), *samples[0].tapes(places[0][:0]).shape[1:]))
    for begin, one, own in zip(ends, samples, places, strict=False):
        here = (rows >= begin) & (rows < begin + len(own))
        tapes[here] = one.tapes(own[rows[here] - begin])
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


def _spread(count: int) -> Integers:
    return (
        np.unique(np.linspace(0, count - 1, min(count, _WEIGHED)).astype(np.int64)) if count else np.arange(0)
    )
