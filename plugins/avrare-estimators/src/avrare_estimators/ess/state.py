"""State of an estimate by nested levels: pilots, the passes that count, and their findings."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from hashlib import blake2b

import numpy as np

from avrare.estimation.checks.result_builder import represent_errors
from avrare.estimation.plan.plan import Info, Plan
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.result import Failures, Worst
from avrare.protocols import Floats
from avrare.rollout.request import Integers, Rollouts
from avrare_estimators.common.chains.level_pass import LevelPass
from avrare_estimators.common.in_turn import far_apart, take_in_turn
from avrare_estimators.common.looks import Looks, Pilot


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
        pilot_rollouts: Rollouts of the pilots.
        tally: Cost so far.
        begun: Rollouts before the present batch of runs.
        looks: When to stop; None before the first pilot has ended.
        pilot: Findings of the first pilot, if there was one.
        ended: Passes of the batches before, without their tapes.
        failures_before: Failures of batches that have ended, the first few.
    """

    plan: Plan
    level_pass: LevelPass
    counting: bool
    worst: Worst
    first: Floats = field(default_factory=lambda: np.zeros(0))
    fresh: FreshRows = field(default_factory=FreshRows)
    pilot_rollouts: int = 0
    tally: Info = field(default_factory=Info)
    begun: int = 0
    looks: Looks | None = None
    pilot: Pilot | None = None
    ended: LevelPass | None = None
    failures_before: Failures | None = None

    @staticmethod
    def begin(plan: Plan, level_pass: LevelPass, looks: Looks | None) -> EssState:
        """Return the state before the first rollout; without ``looks`` the first pass is a pilot."""
        return EssState(plan, level_pass, looks is not None, represent_errors(plan), looks=looks)

    @property
    def runs(self) -> int:
        """Runs begun so far."""
        return self.level_pass.shape.runs + (self.ended.shape.runs if self.ended is not None else 0)

    @property
    def failures(self) -> Failures:
        """Different failing tapes of the passes that count."""
        if self.failures_before is not None:
            return replace(self.failures_before, count=self.tally.failures)
        return _distinct_failures(self.level_pass, self.tally.failures)

    def join_batches(self) -> EssState:
        """Return the state in which all batches are one ended pass."""
        if self.ended is None:
            return self
        assert self.failures_before is not None
        new, most = _distinct_failures(self.level_pass, 0, self.ended.shape.runs), self.plan.kept_failures
        whole = {
            name: np.concatenate([getattr(self.failures_before, name), getattr(new, name)])
            for name in ("noise", "robustness", "weights", "ancestors")
        }
        run = whole["ancestors"][:, 0]
        rows = take_in_turn(run, most)
        thinned = {name: values[rows] for name, values in whole.items()}
        failures = _weighted_anew(Failures(**{**thinned, "weights": whole["weights"]}, count=0), run, rows)
        joined = self.ended.join(self.level_pass.without_tapes())
        return replace(self, level_pass=joined, ended=None, failures_before=failures)

    def next_batch(self, level_pass: LevelPass, counting: bool) -> EssState:
        """Set the ended runs aside and begin further ones."""
        return replace(
            self,
            level_pass=level_pass,
            counting=counting,
            begun=self.tally.rollouts,
            ended=self.level_pass.without_tapes(),
            failures_before=self.failures,
        )

    def tell(self, rollouts: Rollouts) -> EssState:
        """Return the state after the rollouts asked for."""
        first = self.first
        if not self.tally.rollouts:
            first = np.where(rollouts.error, np.nan, rollouts.robustness[:, 0])
        fresh = self.fresh.plus(rollouts) if self.level_pass.fresh is not None else self.fresh
        return replace(
            self,
            tally=self.tally.plus(rollouts),
            worst=self._find_worst(rollouts),
            first=first,
            fresh=fresh,
            level_pass=self.level_pass.tell(rollouts),
        )

    def _find_worst(self, rollouts: Rollouts) -> Worst:
        robustness = np.where(rollouts.error, np.inf, rollouts.robustness[:, 0])
        row = int(np.argmin(robustness))
        least, tapes = self.worst.robustness, self.level_pass.proposal
        if tapes is None or rollouts.error[row] or least <= robustness[row]:
            return self.worst
        return Worst(tapes[row].copy(), float(robustness[row]))


def _distinct_failures(last: LevelPass, count: int, first_run: int = 0) -> Failures:
    # A chain that stays repeats its tape, which then weighs as often. A run's failures share its estimate.
    different: dict[bytes, int] = {}
    points, samples = last.points, last.shape.samples
    hit_weights = (last.weights * last.failed).reshape(-1)
    mass = np.zeros(len(hit_weights))
    for row in np.flatnonzero(points.violated):
        key = blake2b(points.tape[row].tobytes(), digest_size=16).digest()
        mass[different.setdefault(key, int(row))] += hit_weights[row]
    rows = np.array(list(different.values()), dtype=np.int64)
    # Neighbours are samples of one chain: the first of a run to be kept are far apart.
    run = rows // samples
    order = [np.flatnonzero(run == r) for r in np.unique(run)]
    rows = np.concatenate([rows[place][far_apart(len(place))] for place in order] + [rows[:0]])
    run = rows // samples
    total = np.bincount(run, mass[rows], minlength=last.shape.runs)
    weights = mass[rows] * (last.probabilities[run] / np.maximum(total[run], 1e-300))
    chosen = take_in_turn(run, last.plan.kept_failures)
    ancestors = np.stack([first_run + run, points.root[rows]], axis=1)
    failures = Failures(
        points.tape[rows[chosen]], points.robustness[rows[chosen]], count, weights, ancestors[chosen]
    )
    return _weighted_anew(failures, run, chosen)


def _weighted_anew(failures: Failures, run: Integers, chosen: Integers) -> Failures:
    # The chosen ones of a run stand for all of it, whose weights ``failures`` still has.
    weights = failures.weights
    assert weights is not None
    runs = run.max(initial=0) + 1
    before, after = np.bincount(run, weights), np.bincount(run[chosen], weights[chosen], minlength=runs)
    factor = before / np.maximum(after, 1e-300)
    return replace(failures, weights=weights[chosen] * factor[run[chosen]])
