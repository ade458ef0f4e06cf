"""Cross-check: a small splitting run finds failures of its own and compares their weights with the sample's.

A proposal that misses failures gives a sample that looks well: every row that it has drawn has a decent
weight. The missing ones show only to a method that does not use the proposal. Subset simulation (Au and Beck
2001) starts at the target, raises a level of the score, and ends with particles that represent the target's
failures; if the sample represents them too, their weights have the same distribution there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers, Request, Rollouts
from avrare_estimators.importance.sampling import Sample, Stratum
from avrare_estimators.weights import effective_size, mixture_log_weights, resample

MIN_PARTICLES = 8
"""Number of particles below which a cross-check says nothing."""
_FIRST_SIZE, _LEAST_SIZE, _ACCEPTANCE = 0.5, 0.02, 0.35
_SURVIVE = 1.0 / 3.0
"""Share of the particles that survive a level."""
_MARGIN = 1.5
"""Rollouts set aside for the way to failure, over what the sample's own estimate suggests."""


@dataclass(frozen=True)
class CrossCheckResult:
    """Outcome of a cross-check, all of it about failing rows of the target.

    Attributes:
        surprise: Distance of the mean log weight above the sample's, in standard errors.
        unseen: Share of the particles whose weight is above all of the sample's.
        roots: Number of first particles that they descend from.
        probability: Rough estimate of the failure probability by the particles alone.
    """

    surprise: float
    unseen: float
    roots: int
    probability: float


@dataclass(frozen=True)
class CrossCheck:
    """N particles of the target on their way to failure; at first there may be more than N.

    Attributes:
        sample: The sample to compare with.
        stratum: Address of the noise; round k draws from its stage + k.
        particles: N, particles after each level.
        budget: Rollouts left.
        tapes: (N, steps + 1, noise_size).
        score: (N,).
        violated: (N,) the particle fails.
        log_ratio: (N,) log p/q.
        root: (N,) first particle of each.
        moving: (M,) particles that the pending rollouts are for.
        weight: Product of the surviving shares.
        level: All particles lie at or above it.
        reached: All particles fail.
        size: Size of the moves, in (0, 1].
        rounds: Number of rounds done.
        pending: The rollouts asked for.
    """

    sample: Sample
    stratum: Stratum
    particles: int
    budget: int
    tapes: Floats
    score: Floats
    violated: Bools
    log_ratio: Floats
    root: Integers
    moving: Integers
    weight: float = 1.0
    level: float = -math.inf
    reached: bool = False
    size: float = _FIRST_SIZE
    rounds: int = 0
    pending: Request | None = None

    @staticmethod
    def begin(sample: Sample, budget: int) -> CrossCheck | None:
        """Begin a cross-check of ``sample`` by ``budget`` rollouts; None where nothing can be compared."""
        contributions = np.where(sample.violated, np.exp(sample.log_weights), 0.0)
        estimate = min(float(contributions.mean()), 0.5)
        if estimate == 0.0:
            return None
        levels = 1.0 + math.log(estimate) / math.log(_SURVIVE)
        particles = int(budget / (_MARGIN * (1.0 - _SURVIVE) * levels))
        if particles < MIN_PARTICLES:
            return None
        # 1. Start from the target's rows of the sample, or from fresh ones where they are too few.
        stratum = replace(sample.strata[0], stage=sample.strata[0].stage + 1, first=0)
        rows = np.flatnonzero(~sample.error[: sample.target_rows])
        if len(rows) >= particles:
            return CrossCheck(
                sample, stratum, particles, budget, sample.tapes(rows), sample.score[rows],
                sample.violated[rows], sample.log_ratio[rows], root=np.arange(len(rows)), moving=rows[:0],
            )._raise_level()  # fmt: skip
        index = np.arange(particles)
        tapes = stratum.normals(index)
        return CrossCheck(
            sample, stratum, particles, budget - particles, tapes, score=np.full(particles, -np.inf),
            violated=np.zeros(particles, dtype=bool), log_ratio=np.zeros(particles), root=index, moving=index,
            pending=sample.source.target_request(tapes),
        )  # fmt: skip

    def tell(self, rollouts: Rollouts) -> CrossCheck:
        """Accept the moves that stay at or above the level, then raise it."""
        assert self.pending is not None
        assert self.pending.tape is not None
        score = rollouts.scores[:, -1]
        accepted = ~rollouts.error & (rollouts.violated[:, 0] if self.reached else score >= self.level)
        rows = self.moving[accepted]
        log_ratio = self.sample.source.log_ratio(self.pending, rollouts)
        size = self.size
        if self.level > -math.inf:
            factor = math.exp(2.0 * (float(accepted.mean()) - _ACCEPTANCE))
            size = min(1.0, max(_LEAST_SIZE, size * factor))
        return replace(
            self,
            tapes=_with(self.tapes, rows, self.pending.tape[accepted]),
            score=_with(self.score, rows, score[accepted]),
            violated=_with(self.violated, rows, rollouts.violated[accepted, 0]),
            log_ratio=_with(self.log_ratio, rows, log_ratio[accepted]),
            size=size,
            rounds=self.rounds + 1,
            pending=None,
        )._raise_level()

    def _raise_level(self) -> CrossCheck:
        if self.reached:
            return self._propose_moves(np.arange(self.particles))
        # 2. The best third survives; once a third fails, the failures do.
        least = max(2, round(_SURVIVE * self.particles))
        kth = float(np.sort(self.score)[-least])
        reached = bool(self.violated.sum() >= least)
        survive = self.violated if reached else self.score >= kth
        # 3. Replace the others by copies of survivors.
        alive = np.flatnonzero(survive)[: self.particles]
        uniform = float(self.stratum.plan.noise.choices(self.stratum.run, self._stage, 0))
        copies = resample(np.ones(len(alive)), self.particles - len(alive), uniform)
        chosen = np.concatenate([alive, alive[copies]])
        raised = replace(
            self, level=kth, reached=reached, weight=self.weight * float(survive.mean()),
            tapes=self.tapes[chosen], score=self.score[chosen], violated=self.violated[chosen],
            log_ratio=self.log_ratio[chosen], root=self.root[chosen],
        )  # fmt: skip
        # 4. Move the copies.
        return raised._propose_moves(np.arange(len(alive) if len(copies) else 0, self.particles))

    def _propose_moves(self, moving: Integers) -> CrossCheck:
        if len(moving) > self.budget:
            return self
        fresh = replace(self.stratum, stage=self._stage).normals(moving)
        moved = math.sqrt(1.0 - self.size**2) * self.tapes[moving] + self.size * fresh
        pending = self.sample.source.target_request(moved)
        return replace(self, moving=moving, pending=pending, budget=self.budget - len(moving))

    @property
    def _stage(self) -> int:
        return self.stratum.stage + self.rounds

    def result(self) -> CrossCheckResult | None:
        """Compare the particles with the sample; None where they have not reached failure."""
        if not self.reached:
            return None
        found = mixture_log_weights(self.log_ratio, self.sample.share)
        expected = self.sample.log_weights[self.sample.violated]
        expected = expected[np.isfinite(expected)]
        weights = np.exp(expected - expected.max())
        mean = float((weights * expected).sum() / weights.sum())
        variance = float((weights * (expected - mean) ** 2).sum() / weights.sum())
        roots = len(np.unique(self.root))
        finite = found[np.isfinite(found)]
        error = math.sqrt(variance / effective_size(weights) + float(finite.var()) / roots + 1e-12)
        return CrossCheckResult(
            surprise=(float(finite.mean()) - mean) / error,
            unseen=float((found > expected.max()).mean()),
            roots=roots,
            probability=self.weight,
        )


def _with(values: NDArray[Any], rows: Integers, new: NDArray[Any]) -> NDArray[Any]:
    copy = values.copy()
    copy[rows] = new
    return copy
