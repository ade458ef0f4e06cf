"""Lessons: the samples from which a proposal on the noise tape is learnt, weighed together.

Stage 0 is drawn from the target and from tail atoms, stage k + 1 in part from the proposal that stage k has
taught. All rows of all stages are pooled with the weights of the balance heuristic (Veach and Guibas 1995): p
over the density of the pool, whichever stage a row came from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.estimation.plan.plan import Plan
from avrare.protocols import Floats
from avrare.rollout.request import Integers
from avrare_estimators.common.lessons.dictionary import fit
from avrare_estimators.common.samples.sampling import Sample, failing_weights
from avrare_estimators.common.tapes.tail_atoms import SHARE, with_tail_atoms
from avrare_estimators.common.tapes.tape_mixture import TapeMixture, blend
from avrare_estimators.common.weights import effective_size, resample, stratified_variance

LEAST_ELITE = 80.0
"""Effective number of rows to learn from."""
_BLOCK = 2**21
"""Noise numbers that are drawn again at once."""
_FEW = 10.0
"""Effective number of failures from which the gain is that for failures, not for the elite."""


def require_noise(plan: Plan) -> None:
    """Raise a ``UsageError`` where a system has no noise from which to learn."""
    if not plan.noise.noise_size:
        text = "noise_size is 0: without noise nothing leads to failures"
        raise UsageError(text, "all rollouts are alike: use mc, with a single rollout")


@dataclass(frozen=True)
class Lessons:
    """Samples and proposals of the stages so far.

    Attributes:
        defensive: Share of the target in all samples but the first.
        tail: Law of the first sample, but for the target, and of a share of each later one.
        samples: Samples, one a stage.
        mixtures: Proposals; number k has drawn sample k + 1.
        log_ratios: (n, 1 + K) log p/q of the rows of each sample under ``tail`` (infinite where there is
            none) and under each proposal alone.
    """

    defensive: float
    samples: tuple[Sample, ...] = ()
    mixtures: tuple[TapeMixture, ...] = ()
    log_ratios: tuple[Floats, ...] = ()
    tail: TapeMixture | None = None

    def add(self, sample: Sample) -> Lessons:
        """Add the sample of the present proposal."""
        none = np.full(len(sample.error), np.inf)
        columns = [ratios_of(sample, self.tail) if self.tail is not None else none]
        ratios = np.stack([*columns, *(ratios_of(sample, mixture) for mixture in self.mixtures)], axis=1)
        return replace(self, samples=(*self.samples, sample), log_ratios=(*self.log_ratios, ratios))

    def learn(self) -> Lessons:
        """Fit the next proposal to the elite."""
        rows, weights = self.elite
        weights = self._raise_failures(rows, weights)
        most_rows = 500
        if len(rows) > most_rows:
            rows = np.sort(rows[resample(weights, most_rows, 0.5)])
            weights = np.ones(len(rows))
        mixture = fit(self._tapes(rows), weights, self.defensive)
        ratios = tuple(
            np.column_stack([old, ratios_of(sample, mixture)])
            for old, sample in zip(self.log_ratios, self.samples, strict=True)
        )
        return replace(self, mixtures=(*self.mixtures, mixture), log_ratios=ratios)

    def _raise_failures(self, rows: Integers, weights: Floats) -> Floats:
        """Return weights of an elite in which the failures have a share: a score may lead away from them.

        The share is that of their effective number in the one that suffices to learn from failures alone.
        """
        failed = self.violated[rows]
        share = effective_size(weights[failed]) / LEAST_ELITE
        if failed.all() or not share:
            return weights
        total, present = share / (1.0 - share) * weights[~failed].sum(), weights[failed].sum()
        return np.where(failed, weights * max(1.0, total / present), weights)

    @property
    def weights(self) -> Floats:
        """(N,) weights of all rows; their mean over a set estimates its probability."""
        counts = np.array([len(sample.error) for sample in self.samples])
        shares = counts / counts.sum()
        pooled = np.concatenate(self.log_ratios)
        density = np.zeros(len(pooled))
        for k, (share, sample) in enumerate(zip(shares, self.samples, strict=True)):
            target = sample.share
            density += share * (target + (1.0 - target) * np.exp(np.minimum(-self._ratio(pooled, k), 700.0)))
        return np.asarray(1.0 / density)

    def _ratio(self, log_ratios: Floats, k: int) -> Floats:
        """Return log p/q of rows under the law that sample ``k`` was drawn from, but for the target."""
        first = log_ratios[:, 0]
        if not k or self.tail is None:
            return log_ratios[:, k]
        return -np.logaddexp(math.log(SHARE) - first, math.log1p(-SHARE) - log_ratios[:, k])

    @property
    def proposal(self) -> TapeMixture | None:
        """The law that the next sample is drawn from, but for the target; None: the target."""
        if not self.mixtures:
            return self.tail
        return self.mixtures[-1] if self.tail is None else with_tail_atoms(self.mixtures[-1])

    @property
    def violated(self) -> Any:
        """(N,) failures."""
        return np.concatenate([sample.violated for sample in self.samples])

    @property
    def key(self) -> Floats:
        """(N,) order of the rows: by score, all failures on top; rows that broke down have -inf."""
        score = np.concatenate([sample.score for sample in self.samples])
        error = np.concatenate([sample.error for sample in self.samples])
        return np.where(self.violated, np.inf, np.where(error, -np.inf, score))

    @property
    def elite(self) -> tuple[Integers, Floats]:
        """Rows nearest to failure and their weights: all failures, or the fewest that are effective."""
        error = np.concatenate([sample.error for sample in self.samples])
        score = np.concatenate([sample.score for sample in self.samples])
        weights, violated = self.weights, self.violated
        if effective_size(weights[violated]) >= LEAST_ELITE:
            rows = np.flatnonzero(violated)
            return rows, weights[rows]
        key = np.where(violated, np.inf, score)
        order = np.argsort(-key, kind="stable")
        order = order[~error[order]]
        if not len(order):  # every rollout broke down
            return order, weights[order]
        total, squares = np.cumsum(weights[order]), np.cumsum(weights[order] ** 2)
        enough = np.flatnonzero(total**2 >= LEAST_ELITE * squares)
        last = order[enough[0]] if len(enough) else order[-1]
        rows = np.flatnonzero((key >= key[last]) & ~error)
        return rows, weights[rows]

    @property
    def probability(self) -> float:
        """Estimate of the failure probability from all stages."""
        return float(np.where(self.violated, self.weights, 0.0).mean())

    def report(self) -> dict[str, object]:
        """Return the entry of the newest stage."""
        rows, elite = self.elite
        weights, violated = self.weights, self.violated
        newest = self.samples[-1]
        score = np.concatenate([sample.score for sample in self.samples])
        reached = bool(len(rows) and violated[rows].all())
        ratio = self._ratio(np.concatenate(self.log_ratios), len(self.mixtures)) if self.mixtures else None
        variance = self._variance(rows, ratio[rows]) if ratio is not None else None
        chance, variance_there = float(elite.sum() / len(weights)), variance
        if ratio is not None and effective_size(weights[violated]) >= _FEW:
            # A level near the pilot's bulk leaves little to gain; failures are what is to be drawn.
            chance, variance_there = (
                self.probability,
                self._variance(np.flatnonzero(violated), ratio[violated]),
            )
        return {
            "level": None if reached or not len(rows) else float(score[rows][~violated[rows]].min()),
            "reached": reached,
            "rollouts": len(newest.error),
            "failures": int(newest.violated.sum()),
            "probability": float(failing_weights(newest).mean()),
            "level_probability": float(elite.sum() / len(weights)),
            "elite_effective": effective_size(elite),
            "failures_effective": effective_size(weights[violated]),
            "relative_variance": variance,
            "gain": _gain(chance, variance_there),
            "gain_shown": _gain(self.probability, self.shown_variance),
            "components": len(self.mixtures[-1].share) if self.mixtures else 0,
        }

    @property
    def shown_variance(self) -> float | None:
        """Relative variance of one row of the newest sample, by its failures alone; None where they are few.

        No row of it has taught the proposal that it was drawn from.
        """
        values = failing_weights(self.samples[-1])
        if effective_size(values) < _FEW:
            return None
        relative = values / values.mean()
        return len(relative) * stratified_variance(relative, self.samples[-1].target_rows)

    def expected_variance(self, mixture: TapeMixture | None) -> float | None:
        """Return the relative variance of one row drawn from ``mixture`` (None: the target), for failures."""
        if not self.samples or not self.violated.any():
            return None
        if mixture is None:
            return 1.0 / self.probability - 1.0
        rows = np.flatnonzero(self.violated)
        return self._variance(rows, mixture.log_ratio_of(self._tapes(rows)))

    def _variance(self, rows: Integers, log_ratio: Floats) -> float | None:
        """Return the relative variance of one row of a proposal, for the event that holds these rows.

        Args:
            rows: Places of the rows.
            log_ratio: Their log p/q under the proposal.
        """
        weights = self.weights[rows]
        mean = weights.sum() / len(self.violated)
        second = (weights * self.bound_ratio(log_ratio)).sum() / len(self.violated)
        return float(second / mean**2 - 1.0) if mean else None

    def bound_ratio(self, log_ratio: Floats) -> Floats:
        """Return p over the proposal with its share of the target."""
        density = self.defensive + (1.0 - self.defensive) * np.exp(np.minimum(-log_ratio, 700.0))
        return np.asarray(1.0 / density)

    def final(self) -> TapeMixture:
        """Return the proposal to estimate with: the newest, and a little of those before it."""
        before = self.mixtures[:-1]
        past = 0.2  # share of the proposals of earlier stages, which are wider
        shares = [*(past / len(before) for _ in before), 1.0 - past] if before else [1.0]
        learned = blend(self.mixtures, shares)
        return learned if self.tail is None else with_tail_atoms(learned)

    def _tapes(self, rows: Integers) -> Floats:
        begin, tapes = 0, []
        for sample in self.samples:
            end = begin + len(sample.error)
            tapes.append(sample.tapes(rows[(rows >= begin) & (rows < end)] - begin))
            begin = end
        return np.concatenate(tapes)


def _gain(chance: float, variance: float | None) -> float | None:
    return (1.0 / chance - 1.0) / max(variance, 1e-9) if variance is not None and chance else None


def ratios_of(sample: Sample, mixture: TapeMixture) -> Floats:
    """Return log p/q (n,) of all rows of a sample under a proposal."""
    rows, ratios = len(sample.error), []
    size = max(1, _BLOCK // math.prod(mixture.shape))
    for begin in range(0, rows, size):
        tapes = sample.tapes(np.arange(begin, min(begin + size, rows)))
        ratios.append(mixture.log_ratio_of(tapes))
    return np.concatenate(ratios)
