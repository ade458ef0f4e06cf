"""Scale annealing: a cross-check that no score leads.

All noise is inflated until failures are common; from there its scale goes back to 1, among failures alone. A
walker carries a failing tape; its weight is the ratio of the two normal laws, and Markov moves that stay in
failure follow each step (annealed importance sampling with resampling: Neal 2001; Bucher 1988 inflates). The
probability at the first scale times the mean weights is that at scale 1. The scale of some fifty numbers can
be annealed together, that of a long tape cannot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from avrare.estimation.plan.plan import Plan
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Request, Rollouts
from avrare_estimators.common.samples.cross_check import GROUPS, CrossCheckResult
from avrare_estimators.common.samples.sampling import Sample
from avrare_estimators.common.samples.sources import Stratum
from avrare_estimators.common.weights import effective_size, resample

MOST_NUMBERS = 50
"""Numbers of a tape up to which its scale is annealed."""
_SCALES = (1.3, 1.6, 2.0, 2.5, 3.0)
LEAST_ROLLOUTS, ROLLOUTS_TO_VOUCH = 4000, 12_000
"""Rollouts that may suffice, and those that mostly do."""
_FREQUENT = 0.05
"""Share of failures from which a scale is large enough."""
_MOST_WALKERS, _FIRST_OF_WALKER, _MOVES = 50, 4, 4
"""Walkers of a group at most, rollouts at a scale for each, and their moves at a step."""
_LEAST_EFFECTIVE = 0.5
"""Effective share of the walkers to which a step may reduce them."""
_ACCEPTED = 0.3
_STAGE, _STAGES_OF_RUN = 2**31, 2**20


def can_anneal(plan: Plan) -> bool:
    """Return whether the scale of a plan's tapes can be annealed: they have few enough numbers."""
    return (plan.steps + 1) * plan.noise.noise_size <= MOST_NUMBERS


@dataclass(frozen=True)
class ScaleAnnealing:
    """Groups of walkers on their way from inflated noise to the target (a ``Task``).

    Attributes:
        sample: The sample to compare with, which knows how to ask for rollouts.
        budget: Rollouts left.
        scale: Standard deviation of the noise.
        probabilities: (GROUPS,) estimate of each group so far.
        group: Walkers of a group.
        counts: The first scale is chosen, by rollouts that do not count.
        walkers: (GROUPS * group, steps + 1, noise_size) failing tapes; None before they are drawn.
        size: Size of a move.
        move: Moves done at this scale.
        stages: Addresses of noise in use.
        rollouts: Rollouts done.
        pending: The rollouts asked for.
        done: The walkers have arrived.
    """

    sample: Sample
    budget: int
    scale: float
    group: int
    probabilities: Floats = field(default_factory=lambda: np.zeros(GROUPS))
    counts: bool = False
    walkers: Floats | None = None
    size: float = 0.5
    move: int = 0
    stages: int = 0
    rollouts: int = 0
    pending: Request | None = None
    done: bool = False

    @staticmethod
    def begin(samples: Sequence[Sample], budget: int) -> ScaleAnnealing | None:
        """Begin the check of a run's last sample; None where it knows no failure or would not end."""
        sample = samples[-1]
        if not can_anneal(sample.strata[0].plan) or not sample.violated.any() or budget < LEAST_ROLLOUTS:
            return None
        group = min(_MOST_WALKERS, _MOST_WALKERS * budget // ROLLOUTS_TO_VOUCH)
        return ScaleAnnealing(sample, budget, _SCALES[0], group)._inflate()

    def tell(self, rollouts: Rollouts) -> ScaleAnnealing:
        """Continue."""
        done = replace(self, rollouts=self.rollouts + len(rollouts.error), pending=None)
        failed = rollouts.violated[:, 0] & ~rollouts.error
        if self.walkers is None:
            return done._after_inflation(failed)
        walkers = np.where(failed[:, None, None], self._propose(), self.walkers)
        alive = np.repeat(self.probabilities > 0.0, self.group)
        accepted = float(failed[alive].mean()) if alive.any() else 0.0
        size = min(max(self.size * math.exp(accepted - _ACCEPTED), 0.05), 0.95)
        return replace(done, walkers=walkers, size=size, move=self.move + 1, stages=self.stages + 1)._go_on()

    def result(self) -> CrossCheckResult:
        """Return the outcome."""
        return CrossCheckResult(tuple(map(float, self.probabilities)) if self.done else (), self.rollouts)

    @property
    def first(self) -> int:
        """Rollouts of a group at a scale without walkers."""
        return _FIRST_OF_WALKER * self.group if self.counts else self.group

    def _normals(self, rows: int) -> Floats:
        target = self.sample.strata[0]
        stage = (_STAGE + target.run * _STAGES_OF_RUN + self.stages) % 2**32
        return Stratum(target.plan, target.run, stage, rows, from_target=True).normals(np.arange(rows))

    def _ask(self, tapes: Floats) -> ScaleAnnealing:
        if len(tapes) > self.budget:
            return self
        request = self.sample.source.replay(tapes)
        return replace(self, pending=request, budget=self.budget - len(tapes))

    def _inflate(self) -> ScaleAnnealing:
        return self._ask(self.scale * self._normals(GROUPS * self.first))

    def _after_inflation(self, failed: Bools) -> ScaleAnnealing:
        # 1. The least scale at which failures are common; what chose it would count too many.
        if not self.counts:
            larger = [scale for scale in _SCALES if scale > self.scale]
            rare = failed.mean() < _FREQUENT and bool(larger)
            scale = larger[0] if rare else self.scale
            return replace(self, scale=scale, counts=not rare, stages=self.stages + 1)._inflate()
        shares = failed.reshape(GROUPS, self.first).mean(axis=1)
        if not shares.any():
            return self
        tapes = self.scale * self._normals(GROUPS * self.first)
        rows = np.zeros((GROUPS, self.group), np.int64)
        for group in np.flatnonzero(shares):
            begin = group * self.first
            failing = begin + np.flatnonzero(failed[begin : begin + self.first])
            rows[group] = failing[resample(np.ones(len(failing)), self.group, 0.5)]
        began = replace(self, probabilities=shares, walkers=tapes[rows.ravel()], stages=self.stages + 1)
        return began._cool()

    def _go_on(self) -> ScaleAnnealing:
        if self.move < _MOVES:
            return self._ask(self._propose())
        return self._cool() if self.scale > 1.0 else replace(self, done=True)

    def _cool(self) -> ScaleAnnealing:
        # 2. The next scale leaves half of the walkers effective; each group draws its walkers anew.
        assert self.walkers is not None
        squares, numbers = (self.walkers**2).sum(axis=(1, 2)), self.walkers[0].size
        alive = np.flatnonzero(np.repeat(self.probabilities > 0.0, self.group))

        def log_weights(scale: float) -> Floats:
            change = 1.0 / scale**2 - 1.0 / self.scale**2
            return np.asarray(-squares / 2.0 * change - numbers * math.log(scale / self.scale))

        def share(scale: float) -> float:
            logs = log_weights(scale)[alive]
            return effective_size(np.exp(logs - logs.max())) / len(alive)

        low, high = 1.0, self.scale
        while share(1.0) < _LEAST_EFFECTIVE and high - low > 1e-4:
            middle = (low + high) / 2.0
            low, high = (low, middle) if share(middle) >= _LEAST_EFFECTIVE else (middle, high)
        scale = high if high < self.scale and low > 1.0 else 1.0
        weights = np.exp(log_weights(scale)).reshape(GROUPS, self.group)
        target = self.sample.strata[0]
        uniform = target.plan.noise.choices(target.run, _STAGE + self.stages, np.arange(GROUPS))
        rows = np.zeros((GROUPS, self.group), dtype=np.int64)
        for group in np.flatnonzero(self.probabilities):
            rows[group] = group * self.group + resample(weights[group], self.group, float(uniform[group]))
        probabilities = self.probabilities * weights.mean(axis=1)
        cooled = replace(self, scale=scale, probabilities=probabilities, move=0)
        return replace(cooled, walkers=self.walkers[rows.ravel()])._go_on()

    def _propose(self) -> Floats:
        # 3. Moves that leave the inflated law as it is; those that leave failure are refused.
        assert self.walkers is not None
        fresh = self.scale * self._normals(len(self.walkers))
        return math.sqrt(1.0 - self.size**2) * self.walkers + self.size * fresh
