"""Samples of the stages of learning, pooled with the weights of the balance heuristic.

Stage 0 is drawn from the target and from tail atoms, stage k + 1 in part from the proposal that was fitted
after stage k. Whichever stage a row came from, its weight is p / sum_k c_k q_k, where c_k is the share of
stage k in the rows and q_k the density that stage k was drawn from (Veach and Guibas 1995).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from avrare.base.errors import UsageError
from avrare.estimation.plan.plan import Plan
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers
from avrare_estimators.common.learning.dictionary import fit
from avrare_estimators.common.samples.sampling import Sample, failing_weights
from avrare_estimators.common.tapes.tail_atoms import SHARE, with_tail_atoms
from avrare_estimators.common.tapes.tape_mixture import TapeMixture, blend
from avrare_estimators.common.weights import effective_size, resample, stratified_variance

LEAST_ELITE = 80.0
"""Effective number of rows to fit a proposal to."""
_BLOCK = 2**21
"""Noise numbers that are drawn again at once."""
_FEW_FAILURES = 10.0
"""Effective number of failures below which their variance is not estimated."""


def require_noise(plan: Plan) -> None:
    """Raise a ``UsageError`` where a system has no noise from which to learn."""
    if not plan.noise.noise_size:
        text = "noise_size is 0: without noise nothing leads to failures"
        raise UsageError(text, "all rollouts are alike: use mc, with a single rollout")


@dataclass(frozen=True)
class PooledSamples:
    """Samples and proposals of the stages so far.

    Attributes:
        defensive: Share of the target in all samples but the first.
        samples: Samples, one a stage.
        mixtures: Proposals; number k has drawn sample k + 1.
        log_ratios: (n, 1 + K) log p/q of the rows of each sample under ``tail`` (infinite where there is
            none) and under each proposal alone.
        tail: Law of the first sample, apart from its share of the target; each later one has a share of it.
    """

    defensive: float
    samples: tuple[Sample, ...] = ()
    mixtures: tuple[TapeMixture, ...] = ()
    log_ratios: tuple[Floats, ...] = ()
    tail: TapeMixture | None = None

    def add(self, sample: Sample) -> PooledSamples:
        """Add the sample of the newest proposal."""
        none = np.full(len(sample.error), np.inf)
        columns = [compute_log_ratios(sample, self.tail) if self.tail is not None else none]
        columns += [compute_log_ratios(sample, mixture) for mixture in self.mixtures]
        log_ratios = (*self.log_ratios, np.stack(columns, axis=1))
        return replace(self, samples=(*self.samples, sample), log_ratios=log_ratios)

    def fit_proposal(self) -> PooledSamples:
        """Fit the next proposal to the elite."""
        rows, weights = self.elite
        weights = self._raise_failures(rows, weights)
        most_rows = 500
        if len(rows) > most_rows:
            rows = np.sort(rows[resample(weights, most_rows, 0.5)])
            weights = np.ones(len(rows))
        mixture = fit(self._tapes(rows), weights, self.defensive)
        log_ratios = tuple(
            np.column_stack([columns, compute_log_ratios(sample, mixture)])
            for columns, sample in zip(self.log_ratios, self.samples, strict=True)
        )
        return replace(self, mixtures=(*self.mixtures, mixture), log_ratios=log_ratios)

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

    @cached_property
    def weights(self) -> Floats:
        """(N,) balance-heuristic weights of all rows; their mean over an event estimates its probability."""
        counts = np.array([len(sample.error) for sample in self.samples])
        pooled = np.concatenate(self.log_ratios)
        density = np.zeros(len(pooled))
        for stage, (share, sample) in enumerate(zip(counts / counts.sum(), self.samples, strict=True)):
            density += share * _relative_density(self._log_ratio(pooled, stage), sample.share)
        return np.asarray(1.0 / density)

    def _log_ratio(self, log_ratios: Floats, stage: int) -> Floats:
        """Return log p/q of rows under the law of a stage, apart from its share of the target."""
        first = log_ratios[:, 0]
        if not stage or self.tail is None:
            return log_ratios[:, stage]
        return -np.logaddexp(math.log(SHARE) - first, math.log1p(-SHARE) - log_ratios[:, stage])

    @property
    def proposal(self) -> TapeMixture | None:
        """Law of the next sample, apart from its share of the target; None: the target alone."""
        if not self.mixtures:
            return self.tail
        return self.mixtures[-1] if self.tail is None else with_tail_atoms(self.mixtures[-1])

    @cached_property
    def violated(self) -> Bools:
        """(N,) failures."""
        return np.concatenate([sample.violated for sample in self.samples])

    @cached_property
    def _score(self) -> Floats:
        return np.concatenate([sample.score for sample in self.samples])

    @cached_property
    def elite(self) -> tuple[Integers, Floats]:
        """Rows nearest to failure and their weights: all failures, or the fewest that are effective."""
        if effective_size(self.weights[self.violated]) >= LEAST_ELITE:
            rows = np.flatnonzero(self.violated)
            return rows, self.weights[rows]
        intact = ~np.concatenate([sample.error for sample in self.samples])
        key = np.where(self.violated, np.inf, self._score)
        order = np.argsort(-key, kind="stable")
        order = order[intact[order]]
        if not len(order):  # every rollout broke down
            return order, self.weights[order]
        total, squares = np.cumsum(self.weights[order]), np.cumsum(self.weights[order] ** 2)
        enough = np.flatnonzero(total**2 >= LEAST_ELITE * squares)
        last = order[enough[0]] if len(enough) else order[-1]
        rows = np.flatnonzero((key >= key[last]) & intact)
        return rows, self.weights[rows]

    @property
    def probability(self) -> float:
        """Estimate of the failure probability from all stages."""
        return float(np.where(self.violated, self.weights, 0.0).mean())

    def describe_stage(self) -> dict[str, object]:
        """Return the numbers of the newest stage for the diagnostics: level, failures, gain and others."""
        rows, elite_weights = self.elite
        newest, violated, size = self.samples[-1], self.violated, len(self.violated)
        reached = bool(len(rows) and violated[rows].all())
        failures_effective = effective_size(self.weights[violated])
        level_probability = float(elite_weights.sum() / size)
        gain = variance = None
        if self.mixtures:
            log_ratio = self._log_ratio(np.concatenate(self.log_ratios), len(self.mixtures))
            variance = self._relative_variance(rows, log_ratio[rows])
            gain = _gain(level_probability, variance)
            if failures_effective >= _FEW_FAILURES:
                # A level near the pilot's bulk leaves little to gain; failures are what is to be drawn.
                failures = np.flatnonzero(violated)
                gain = _gain(self.probability, self._relative_variance(failures, log_ratio[failures]))
        return {
            "level": None if reached or not len(rows) else float(self._score[rows][~violated[rows]].min()),
            "reached": reached,
            "rollouts": len(newest.error),
            "failures": int(newest.violated.sum()),
            "probability": float(failing_weights(newest).mean()),
            "level_probability": level_probability,
            "elite_effective": effective_size(elite_weights),
            "failures_effective": failures_effective,
            "relative_variance": variance,
            "gain": gain,
            "gain_shown": _gain(self.probability, self.fresh_variance),
            "components": len(self.mixtures[-1].share) if self.mixtures else 0,
        }

    @property
    def fresh_variance(self) -> float | None:
        """Relative variance of one row of the newest sample, by its failures alone; None where they are few.

        The proposal of that sample was fitted to other rows.
        """
        newest = self.samples[-1]
        weights = failing_weights(newest)
        if effective_size(weights) < _FEW_FAILURES:
            return None
        relative = weights / weights.mean()
        return len(relative) * stratified_variance(relative, newest.target_rows)

    def expected_variance(self, mixture: TapeMixture | None) -> float | None:
        """Return the relative variance of one row drawn from ``mixture`` (None: the target), for failures."""
        if not self.samples or not self.violated.any():
            return None
        if mixture is None:
            return 1.0 / self.probability - 1.0
        rows = np.flatnonzero(self.violated)
        return self._relative_variance(rows, mixture.log_ratio_of(self._tapes(rows)))

    def _relative_variance(self, rows: Integers, log_ratio: Floats) -> float | None:
        """Return the relative variance of one row of a proposal, for the event that consists of some rows.

        Args:
            rows: Places of the rows.
            log_ratio: Their log p/q under the proposal.
        """
        weights, size = self.weights[rows], len(self.violated)
        mean = weights.sum() / size
        second = (weights * (1.0 / _relative_density(log_ratio, self.defensive))).sum() / size
        return float(second / mean**2 - 1.0) if mean else None

    def blend_proposals(self) -> TapeMixture:
        """Return the proposal to estimate with: the newest, and a little of those before it."""
        earlier = self.mixtures[:-1]
        earlier_share = 0.2  # earlier proposals are wider
        shares = [*(earlier_share / len(earlier) for _ in earlier), 1.0 - earlier_share] if earlier else [1.0]
        learned = blend(self.mixtures, shares)
        return learned if self.tail is None else with_tail_atoms(learned)

    def _tapes(self, rows: Integers) -> Floats:
        begin, tapes = 0, []
        for sample in self.samples:
            end = begin + len(sample.error)
            tapes.append(sample.tapes(rows[(rows >= begin) & (rows < end)] - begin))
            begin = end
        return np.concatenate(tapes)


def compute_log_ratios(sample: Sample, mixture: TapeMixture) -> Floats:
    """Return log p/q (n,) of all rows of a sample under a proposal."""
    size = max(1, _BLOCK // math.prod(mixture.shape))
    blocks = np.split(np.arange(len(sample.error)), range(size, len(sample.error), size))
    return np.concatenate([mixture.log_ratio_of(sample.tapes(rows)) for rows in blocks])


def _relative_density(log_ratio: Floats, target_share: float) -> Floats:
    """Return the density of a proposal with a share of the target, over that of the target."""
    return target_share + (1.0 - target_share) * np.exp(np.minimum(-log_ratio, 700.0))  # finite


def _gain(chance: float, variance: float | None) -> float | None:
    return (1.0 / chance - 1.0) / max(variance, 1e-9) if variance is not None and chance else None
