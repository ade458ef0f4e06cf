"""A second look: a small splitting run finds failures of its own and asks how they would have been weighed.

A proposal that misses failures gives a sample that looks well: all that it has drawn has a decent weight.
What is missing shows only to somebody who has not used the proposal. Subset simulation (Au and Beck 2001)
starts at the target, raises a level of the score, and ends with particles that stand for the target's
failures; if the sample stands for them too, their weights have the same distribution there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers, Request, Rollouts
from avrare_estimators.sampling import Sample
from avrare_estimators.sources import Part, Source
from avrare_estimators.weights import effective_size, mixture_log_weights, resample

FEWEST = 8
"""Particles below which a look tells nothing."""
_FIRST_SIZE, _ACCEPTANCE = 0.5, 0.35
_SURVIVE = 1.0 / 3.0
"""Share of the particles that outlive a level."""
_MARGIN = 1.5
"""Cost set aside for the way to failure, over what the sample's own estimate suggests."""


@dataclass(frozen=True)
class Seen:
    """What a look has found; all of it about rows of the target that fail.

    Attributes:
        surprise: By how many standard errors the mean log weight lies above the sample's.
        unseen: Share of the particles whose weight is above all of the sample's.
        roots: First particles that they descend from.
        probability: The look's own rough estimate of the failure probability.
    """

    surprise: float
    unseen: float
    roots: int
    probability: float


@dataclass(frozen=True)
class SecondLook:
    """N particles of the target on their way to failure; at first there may be more than N.

    Attributes:
        source: The proposal, for weights.
        part: Address of the sample; round k draws from stage + 1 + k.
        sample: What it is to be compared with.
        many: N, how many are kept at each level.
        budget: Rollouts left.
        tapes: (N, steps + 1, noise_size).
        score: (N,).
        violated: (N,).
        log_ratio: (N,) log p/q.
        root: (N,) first particle of each.
        moving: (M,) particles that the pending rollouts are for.
        weight: Product of the surviving shares.
        level: All particles lie at or above it.
        reached: All particles fail.
        size: Of the moves, in (0, 1].
        done: Rounds done.
        pending: The rollouts in hand.
    """

    source: Source
    part: Part
    sample: Sample
    many: int
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
    done: int = 0
    pending: Request | None = None

    @staticmethod
    def begin(sample: Sample, budget: int) -> SecondLook | None:
        """A look at ``sample`` for ``budget`` rollouts; None where there is nothing to compare."""
        contributions = np.where(sample.violated, np.exp(sample.log_weights), 0.0)
        estimate = min(float(contributions.mean()), 0.5)
        if estimate == 0.0:
            return None
        levels = 1.0 + math.log(estimate) / math.log(_SURVIVE)
        many = int(budget / (_MARGIN * (1.0 - _SURVIVE) * levels))
        if many < FEWEST:
            return None
        look = SecondLook._of_sample(sample, budget, many)
        if len(look.score) >= many:
            return look._raised()
        index = np.arange(many)
        look = replace(
            look, tapes=look.part.fresh(index), score=np.full(many, -np.inf), log_ratio=np.zeros(many),
            violated=np.zeros(many, dtype=bool), root=index, moving=index, budget=budget - many,
        )  # fmt: skip
        return replace(look, pending=look.source.target_request(look.tapes))

    @staticmethod
    def _of_sample(sample: Sample, budget: int, many: int) -> SecondLook:
        """Starts from the rows of the target that the sample has anyway."""
        rows = np.flatnonzero(~sample.error[: sample.target_rows])
        part = replace(sample.parts[0], stage=sample.parts[0].stage + 1, first=0)
        return SecondLook(
            sample.source, part, sample, many, budget, sample.tapes(rows), sample.score[rows],
            sample.violated[rows], sample.log_ratio[rows], root=np.arange(len(rows)), moving=rows[:0],
        )  # fmt: skip

    def tell(self, rollouts: Rollouts) -> SecondLook:
        """Accept the moves that stay at or above the level, then raise it."""
        assert self.pending is not None
        assert self.pending.tape is not None
        score = rollouts.scores[:, -1]
        accepted = ~rollouts.error & (rollouts.violated[:, 0] if self.reached else score >= self.level)
        rows = self.moving[accepted]
        look = replace(
            self,
            tapes=_with(self.tapes, rows, self.pending.tape[accepted]),
            score=_with(self.score, rows, score[accepted]),
            violated=_with(self.violated, rows, rollouts.violated[accepted, 0]),
            log_ratio=_with(self.log_ratio, rows, self.source.log_ratio(self.pending, rollouts)[accepted]),
            pending=None,
        )
        if self.level > -math.inf:
            factor = math.exp(2.0 * (float(accepted.mean()) - _ACCEPTANCE))
            look = replace(look, size=min(1.0, max(0.02, self.size * factor)))
        return replace(look, done=self.done + 1)._raised()

    def _raised(self) -> SecondLook:
        """The next level: the best third survives, the others become moved copies of it."""
        if self.reached:
            return self._move(np.arange(self.many))
        least = max(2, round(_SURVIVE * self.many))
        kth = float(np.sort(self.score)[-least])
        reached = bool(self.violated.sum() >= least)
        survive = self.violated if reached else self.score >= kth
        look = replace(self, level=kth, reached=reached, weight=self.weight * float(survive.mean()))
        alive = np.flatnonzero(survive)[: self.many]
        uniform = float(self.part.plan.noise.choices(self.part.run, self._stage, 0))
        copies = resample(np.ones(len(alive)), self.many - len(alive), uniform)
        chosen = np.concatenate([alive, alive[copies]])
        look = replace(
            look, tapes=look.tapes[chosen], score=look.score[chosen], violated=look.violated[chosen],
            log_ratio=look.log_ratio[chosen], root=look.root[chosen],
        )  # fmt: skip
        return look._move(np.arange(len(alive) if len(copies) else 0, self.many))

    def _move(self, moving: Integers) -> SecondLook:
        """Propose moves, if the budget pays for them; they leave the target as it is."""
        if len(moving) > self.budget:
            return self
        fresh = replace(self.part, stage=self._stage).fresh(moving)
        moved = math.sqrt(1.0 - self.size**2) * self.tapes[moving] + self.size * fresh
        pending = self.source.target_request(moved)
        return replace(self, moving=moving, pending=pending, budget=self.budget - len(moving))

    @property
    def _stage(self) -> int:
        return self.part.stage + self.done

    def seen(self) -> Seen | None:
        """What the particles say of the sample; None where they have not come to failure."""
        if not self.reached:
            return None
        found = mixture_log_weights(self.log_ratio, self.sample.share)
        mine = self.sample.log_weights[self.sample.violated]
        mine = mine[np.isfinite(mine)]
        weights = np.exp(mine - mine.max())
        mean = float((weights * mine).sum() / weights.sum())
        variance = float((weights * (mine - mean) ** 2).sum() / weights.sum())
        roots = len(np.unique(self.root))
        finite = found[np.isfinite(found)]
        error = math.sqrt(variance / effective_size(weights) + float(finite.var()) / roots + 1e-12)
        return Seen(
            surprise=(float(finite.mean()) - mean) / error,
            unseen=float((found > mine.max()).mean()),
            roots=roots,
            probability=self.weight,
        )


def _with(values: NDArray[Any], rows: Integers, new: NDArray[Any]) -> NDArray[Any]:
    """A copy with ``rows`` replaced."""
    copy = values.copy()
    copy[rows] = new
    return copy
