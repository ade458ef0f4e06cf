"""State of an estimate by nested levels: pilots, the passes that count, and what they have found."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from avrare.estimation.plan import Info, Plan
from avrare.estimation.result import Failures, Worst
from avrare.estimation.result_builder import missing_worst
from avrare.protocols import Floats
from avrare.rollout.request import Rollouts
from avrare_estimators.ess.level_pass import LevelPass
from avrare_estimators.fresh import FreshRows
from avrare_estimators.looks import Looks, Pilot


@dataclass(frozen=True)
class EssState:
    """State of all runs.

    Attributes:
        plan: The task.
        level_pass: The pass under way, or the last one.
        counting: It is the pass that counts.
        worst: The least robust rollout so far.
        first: Robustness of the first draw, NaN for errors.
        fresh: Counts of the first draws of both passes.
        pilot: Rollouts of the pilots.
        tally: Cost so far.
        begun: Rollouts before the present batch of runs.
        looks: When to stop; None before the first pilot has ended.
        found: What the first pilot has found, if there was one.
        ended: Passes of the batches before, without their tapes.
        kept: Failures of batches that have ended, the first few.
    """

    plan: Plan
    level_pass: LevelPass
    counting: bool
    worst: Worst
    first: Floats = field(default_factory=lambda: np.zeros(0))
    fresh: FreshRows = field(default_factory=FreshRows)
    pilot: int = 0
    tally: Info = field(default_factory=Info)
    begun: int = 0
    looks: Looks | None = None
    found: Pilot | None = None
    ended: LevelPass | None = None
    kept: Failures | None = None

    @staticmethod
    def begin(plan: Plan, level_pass: LevelPass, looks: Looks | None) -> EssState:
        """Return the state before the first rollout; without ``looks`` the first pass is a pilot."""
        return EssState(plan, level_pass, looks is not None, missing_worst(plan), looks=looks)

    @property
    def runs(self) -> int:
        """Runs begun so far."""
        return self.level_pass.shape.runs + (self.ended.shape.runs if self.ended is not None else 0)

    @property
    def failures(self) -> Failures:
        """Different failing tapes of the passes that count."""
        if self.kept is not None:
            return replace(self.kept, count=self.tally.failures)
        return _distinct_failures(self.level_pass, self.tally.failures)

    def joined(self) -> EssState:
        """Return the state in which all batches are one ended pass."""
        if self.ended is None:
            return self
        assert self.kept is not None
        new = _distinct_failures(self.level_pass, 0)
        kept = Failures(
            np.concatenate([self.kept.noise, new.noise])[: self.plan.kept_failures],
            np.concatenate([self.kept.robustness, new.robustness])[: self.plan.kept_failures], 0,
        )  # fmt: skip
        whole = self.ended.joined(self.level_pass.without_tapes())
        return replace(self, level_pass=whole, ended=None, kept=kept)

    def next_batch(self, level_pass: LevelPass, counting: bool) -> EssState:
        """Set the ended runs aside and begin further ones."""
        return replace(
            self, level_pass=level_pass, counting=counting, begun=self.tally.rollouts,
            ended=self.level_pass.without_tapes(), kept=self.failures,
        )  # fmt: skip

    def tell(self, rollouts: Rollouts) -> EssState:
        """Return the state after the rollouts asked for."""
        first = self.first
        if not self.tally.rollouts:
            first = np.where(rollouts.error, np.nan, rollouts.robustness[:, 0])
        fresh = self.fresh.plus(rollouts) if self.level_pass.fresh is not None else self.fresh
        return replace(
            self, tally=self.tally.plus(rollouts), worst=self._worst(rollouts), first=first,
            fresh=fresh, level_pass=self.level_pass.tell(rollouts),
        )  # fmt: skip

    def _worst(self, rollouts: Rollouts) -> Worst:
        robustness = np.where(rollouts.error, np.inf, rollouts.robustness[:, 0])
        row = int(np.argmin(robustness))
        known, tapes = self.worst.robustness, self.level_pass.proposal
        if tapes is None or rollouts.error[row] or known <= robustness[row]:
            return self.worst
        return Worst(tapes[row].copy(), float(robustness[row]))


def _distinct_failures(last: LevelPass, count: int) -> Failures:
    # A chain that stays repeats its tape.
    different: dict[bytes, int] = {}
    for row in np.flatnonzero(last.points.violated):
        if len(different) == last.plan.kept_failures:
            break
        different.setdefault(last.points.tape[row].tobytes(), int(row))
    rows = np.array(list(different.values()), dtype=np.int64)
    return Failures(last.points.tape[rows], last.points.robustness[rows], count)
