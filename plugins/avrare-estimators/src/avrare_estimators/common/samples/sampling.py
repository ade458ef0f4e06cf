"""Weighted samples: rows of the target and of a proposal, drawn in waves.

A sample has an address (run, stage) and two strata: rows drawn from the target itself, and rows drawn from
the proposal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from avrare.base.memory import allowance
from avrare.estimation.plan.plan import Plan
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Carry, Integers, Request, Rollouts
from avrare_estimators.common.samples.sources import BLOCK, PerceptionSource, Source, Stratum
from avrare_estimators.common.weights import mixture_log_weights, stratified_variance

_TAPES = 3
"""Tapes of each row of a wave at the peak: drawn, asked for, and weighed."""


def wave_bytes(plan: Plan, memory: float | None) -> int:
    """Return the bytes of a wave at its peak."""
    return _wave_rows(plan, memory) * _TAPES * plan.tape_bytes


def _wave_rows(plan: Plan, memory: float | None) -> int:
    """Return the rows of a wave: some chunks, or fewer where their tapes would take half of the memory."""
    room = allowance(memory) // (2 * _TAPES * plan.tape_bytes)
    return min(8 * plan.chunk, max(BLOCK, room))  # chunks in flight


@dataclass(frozen=True)
class PartialSample:
    """A sample under way: first the target's rows, then the proposal's.

    Attributes:
        source: The proposal.
        strata: The target's rows and the proposal's.
        wave: Rows of a wave.
        outcomes: Rollouts of the waves so far.
        ratios: Their log p/q.
    """

    source: Source
    strata: tuple[Stratum, Stratum]
    wave: int
    outcomes: tuple[Rollouts, ...] = ()
    ratios: tuple[Floats, ...] = ()

    @staticmethod
    def begin(
        source: Source, plan: Plan, run: int, stage: int, rows: int, share: float, memory: float | None
    ) -> PartialSample:
        """Begin a sample of ``rows`` rows, a ``share`` of them from the target, in waves."""
        target_rows = round(share * rows)
        target = Stratum(plan, run, stage, target_rows, from_target=True)
        proposal = Stratum(plan, run, stage, rows - target_rows, from_target=False, first=target_rows)
        return PartialSample(source, (target, proposal), _wave_rows(plan, memory))

    def tell(self, rollouts: Rollouts) -> PartialSample:
        """Store the present wave."""
        assert self.pending is not None
        ratio = self.source.log_ratio(self.pending, rollouts)
        rollouts = replace(rollouts, features=rollouts.features.astype(np.float32))
        return replace(self, outcomes=(*self.outcomes, rollouts), ratios=(*self.ratios, ratio))

    @cached_property
    def pending(self) -> Request | None:
        """The present wave; None when all rows are in."""
        done = sum(map(len, self.ratios))
        if isinstance(self.source, PerceptionSource):
            for stratum in self.strata:
                if done < stratum.rows:
                    index = np.arange(done, min(done + self.wave, stratum.rows))
                    return self.source.request(stratum, index)
                done -= stratum.rows
            return None
        index = np.arange(done, min(done + self.wave, self.rows))
        return self.source.replay(draw_tapes(self.source, self.strata, index)) if len(index) else None

    @property
    def rows(self) -> int:
        """Number of rows."""
        return sum(stratum.rows for stratum in self.strata)

    def sample(self) -> Sample:
        """Return the sample, once all rows are in."""
        outcome = Rollouts.join(list(self.outcomes))
        score = outcome.scores[:, -1] if outcome.scores.shape[1] else -outcome.robustness[:, 0]
        return Sample(
            self.source,
            self.strata,
            np.concatenate(self.ratios),
            outcome.violated[:, 0],
            outcome.error,
            outcome.robustness[:, 0],
            score,
            outcome.carries,
            outcome.features,
        )


@dataclass(frozen=True)
class Sample:
    """Rows with their weights; the target's rows come first.

    Attributes:
        source: The proposal.
        strata: Those of the target's rows, then those of the proposal's.
        log_ratio: (n,) log p/q.
        violated: (n,) the row fails.
        error: (n,) the row broke down.
        robustness: (n,).
        score: (n,) importance score; higher is nearer to failure.
        carries: (t, rows, carry) of every step, where the source asks for them.
        features: (n, K, F) at the steps that the source observes.
    """

    source: Source
    strata: tuple[Stratum, ...]
    log_ratio: Floats
    violated: Bools
    error: Bools
    robustness: Floats
    score: Floats
    carries: tuple[tuple[int, Integers, Carry], ...]
    features: Any = field(default_factory=lambda: np.zeros((0, 0, 0), np.float32))

    @property
    def target_rows(self) -> int:
        """Number of rows drawn from the target."""
        return sum(stratum.rows for stratum in self.strata if stratum.from_target)

    @property
    def share(self) -> float:
        """Share of the target's rows."""
        return self.target_rows / len(self.error)

    @property
    def log_weights(self) -> Floats:
        """(n,) log of the deterministic-mixture weights."""
        return mixture_log_weights(self.log_ratio, self.share)

    @property
    def fresh(self) -> FreshRows:
        """Counts of the target's rows."""
        rows = slice(self.target_rows)
        return FreshRows(self.target_rows, int(self.violated[rows].sum()), int(self.error[rows].sum()))

    def tapes(self, index: Integers) -> Floats:
        """Draw the tapes (len(index), steps + 1, noise_size) of rows ``index`` again."""
        return draw_tapes(self.source, self.strata, index)

    def without_carries(self) -> Sample:
        """Return the sample without the carries, which only the fit of a proposal needs."""
        return replace(self, carries=())


def draw_tapes(source: Source, strata: Sequence[Stratum], index: Integers) -> Floats:
    """Draw the tapes (len(index), steps + 1, noise_size) of rows ``index`` of successive strata."""
    plan = strata[0].plan
    tapes, begin = np.empty((len(index), plan.steps + 1, plan.noise.noise_size)), 0
    for stratum in strata:
        here = (index >= begin) & (index < begin + stratum.rows)
        tapes[here] = source.tapes(stratum, index[here] - begin)
        begin += stratum.rows
    return tapes


def failing_weights(sample: Sample) -> Floats:
    """Return the weight (n,) of the failing rows, 0 for the others."""
    return np.where(sample.violated, np.exp(sample.log_weights), 0.0)


def variance_of_sum(parts: Sequence[tuple[float, Sample]], unit: float) -> float:
    """Return the variance of the sum of estimates, each times its share, in units of ``unit``.

    Args:
        parts: Shares and samples.
        unit: Divisor of the estimates, such as their sum.
    """
    return sum(
        share**2 * stratified_variance(failing_weights(sample) / unit, sample.target_rows)
        for share, sample in parts
    )
