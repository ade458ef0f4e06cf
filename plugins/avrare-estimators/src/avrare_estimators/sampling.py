"""A weighted sample: rows of the target and of a proposal, drawn in waves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from avrare.estimation.plan import Plan
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Carry, Integers, Request, Rollouts
from avrare_estimators.sources import Part, Source
from avrare_estimators.weights import mixture_log_weights

_WAVE = 8
"""Chunks in flight at a time."""


@dataclass(frozen=True)
class Drawing:
    """A sample being drawn: first the target's rows, then the proposal's.

    Attributes:
        source: The proposal.
        parts: The target's rows and the proposal's.
        outcomes: Of the waves so far.
        ratios: log p/q of the waves so far.
        pending: The wave in hand; None when all rows are in.
    """

    source: Source
    parts: tuple[Part, Part]
    outcomes: tuple[Rollouts, ...] = ()
    ratios: tuple[Floats, ...] = ()
    pending: Request | None = None

    @staticmethod
    def begin(source: Source, plan: Plan, run: int, stage: int, rows: int, target_rows: int) -> Drawing:
        """Of ``rows`` rows, ``target_rows`` from the target."""
        target = Part(plan, run, stage, target_rows, from_target=True)
        proposal = Part(plan, run, stage, rows - target_rows, from_target=False, first=target_rows)
        return Drawing(source, (target, proposal))._asking()

    def tell(self, rollouts: Rollouts) -> Drawing:
        """With one more wave."""
        assert self.pending is not None
        ratio = self.source.log_ratio(self.pending, rollouts)
        return replace(
            self, outcomes=(*self.outcomes, rollouts), ratios=(*self.ratios, ratio), pending=None
        )._asking()

    def _asking(self) -> Drawing:
        done = sum(map(len, self.ratios))
        for part in self.parts:
            if done < part.rows:
                index = np.arange(done, min(done + _WAVE * part.plan.chunk, part.rows))
                return replace(self, pending=self.source.request(part, index))
            done -= part.rows
        return self

    def sample(self) -> Sample:
        """Once all rows are in."""
        outcome = Rollouts.join(list(self.outcomes))
        score = outcome.scores[:, -1] if outcome.scores.shape[1] else -outcome.robustness[:, 0]
        return Sample(
            self.source, self.parts, np.concatenate(self.ratios), outcome.violated[:, 0], outcome.error,
            outcome.robustness[:, 0], score, outcome.carries,
        )  # fmt: skip


@dataclass(frozen=True)
class Sample:
    """Rows with their weights; the target's rows come first.

    Attributes:
        source: The proposal.
        parts: The target's rows and the proposal's.
        log_ratio: (n,) log p/q.
        violated: (n,) the row fails.
        error: (n,) the row broke down.
        robustness: (n,).
        score: (n,) importance score; higher is nearer to failure.
        carries: (t, rows, carry) of every step, where the source wants them.
    """

    source: Source
    parts: tuple[Part, Part]
    log_ratio: Floats
    violated: Bools
    error: Bools
    robustness: Floats
    score: Floats
    carries: tuple[tuple[int, Integers, Carry], ...]

    @property
    def target_rows(self) -> int:
        """Rows drawn from the target."""
        return self.parts[0].rows

    @property
    def share(self) -> float:
        """Share of the target's rows."""
        return self.target_rows / len(self.error)

    @property
    def log_weights(self) -> Floats:
        """(n,) log of the deterministic-mixture weights."""
        return mixture_log_weights(self.log_ratio, self.share)

    def tapes(self, index: Integers) -> Floats:
        """Tapes (len(index), steps + 1, noise_size) of rows ``index``, drawn again."""
        target, proposal = self.parts
        first = target.rows
        mine = index < first
        tapes = np.empty((len(index), target.plan.steps + 1, target.plan.noise.noise_size))
        tapes[mine] = self.source.tapes(target, index[mine])
        tapes[~mine] = self.source.tapes(proposal, index[~mine] - first)
        return tapes

    def slim(self) -> Sample:
        """Without the states of the steps, which nobody needs once a proposal has been fitted."""
        return replace(self, carries=())
