"""Monte Carlo: the reference that every other estimator is measured against."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from avrare.errors import UsageError
from avrare.estimation import health, intervals
from avrare.estimation.config import McConfig
from avrare.estimation.plan import Info, Plan
from avrare.estimation.result import Failures, Result, Worst
from avrare.estimation.sequential import AtFailures, AtThreshold, Stopping
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Request, Rollouts, total_counts

FAILURE_LIMIT = 100
"""Failing tapes that a result keeps."""
_WAVE = 8
"""Chunks in flight at a time."""
_FIRST_WAVE = 64
"""Rollouts before the first look at the clock; then as many again as are done, so that none comes late."""
_LOOK = 32
"""Share of what is done, 1 / 32, that a rule that stops may come too late by."""
_UNLIMITED = 2**40
"""Rollouts of a run that ends by the clock."""


def build(config: McConfig, scene: object | None = None) -> MonteCarlo:
    """The estimator of a scenario or a call."""
    return MonteCarlo(config)


@dataclass(frozen=True)
class McState:
    """Outcomes so far, in order.

    Attributes:
        plan: The task.
        total: Rollouts to do, over all runs.
        per_run: Rollouts of one run.
        parts: Outcomes of the waves so far.
        info: What they add up to.
    """

    plan: Plan
    total: int
    per_run: int
    parts: tuple[Rollouts, ...]
    info: Info


class MonteCarlo:
    """Binomial estimate with the exact interval of Clopper and Pearson.

    With ``relative_error`` or ``threshold`` it stops by a rule that keeps its confidence
    (``avrare.estimation.sequential``): looking at a fixed-size interval until it pleases would not. Each
    specification has its own stop; rollouts beyond it are paid for and not used.
    """

    name = "mc"
    single = False

    def __init__(self, config: McConfig) -> None:
        self.config = config
        self.stops_early = config.early_stop

    def init(self, plan: Plan) -> tuple[McState, Info]:
        """State before the first rollout, and what to show."""
        per_run = self.config.most
        if plan.budget is not None:
            per_run = _affordable(plan, self.config)
        open_ended = per_run == _UNLIMITED or self.config.sequential
        goal = None if open_ended else per_run * self.config.runs
        info = Info(goal=goal)
        return McState(plan, per_run * self.config.runs, per_run, (), info), info

    def ask(self, state: McState) -> Request | None:
        """The next wave of fresh rollouts."""
        done, wave = state.info.rollouts, _WAVE * state.plan.chunk
        if done >= state.total or self._satisfied(state):
            return None
        if state.info.goal is None:  # no larger than what is done, so that little is paid in vain
            wave = min(wave, max(min(_FIRST_WAVE, state.plan.chunk), done))
            if self.config.sequential:  # every look is at all that is done: else they would cost its square
                wave = max(wave, done // _LOOK)
        index = np.arange(done, min(done + wave, state.total))
        request = Request.from_start(index // state.per_run, index % state.per_run)
        return replace(request, stop_early=self.config.early_stop)

    def tell(self, state: McState, rollouts: Rollouts) -> tuple[McState, Info]:
        """Store the wave."""
        info = state.info.plus(rollouts)
        return McState(state.plan, state.total, state.per_run, (*state.parts, rollouts), info), info

    def estimate(self, state: McState) -> list[Result]:
        """One result per specification, all from the same rollouts."""
        outcome = Rollouts.join(list(state.parts))
        return [self._result(state, outcome, column) for column in range(len(state.plan.names))]

    def _result(self, state: McState, outcome: Rollouts, column: int) -> Result:
        plan, paid = state.plan, len(outcome.error)
        stopping = self._stopping(plan)
        stop = stopping.at(outcome.violated[:, column], outcome.error) if stopping else 0
        used = slice(0, stop or paid)
        violated, error = outcome.violated[used, column], outcome.error[used]
        trials, failures, errors = len(error), int(violated.sum()), int(error.sum())
        values = self._values(state, violated)
        if stopping:
            values = np.array([stopping.value(violated, stop)])
        probability = float(values.mean())
        robustness = np.where(error, np.nan, outcome.robustness[used, column])
        warnings = health.of_errors(errors, trials, plan.max_error_rate, outcome.messages)
        if failures == trials:
            warnings |= health.warn("all_failed")
        interval = stopping.interval(stop) if stopping else intervals.clopper_pearson
        known = probability > 0.0
        return Result(
            specification=plan.names[column],
            estimator=self.name,
            probability=probability,
            interval_at=partial(interval, failures, trials, undecided=errors),
            confidence=plan.confidence,
            run_probabilities=values,
            relative_error=math.sqrt((1 - probability) / (probability * trials)) if known else math.nan,
            rollouts=paid,
            simulated_steps=outcome.simulated_steps,
            errors=errors,
            health=warnings,
            failures=self._failures(state, violated, robustness),
            worst=self._worst(state, robustness),
            robustness=robustness,
            counts=total_counts([outcome]),
            diagnostics={"used_rollouts": trials, "goal_reached": bool(stop)} if stopping else {},
        )

    def _stopping(self, plan: Plan) -> Stopping | None:
        """By what it may stop early, if by anything."""
        if self.config.relative_error is not None:
            return AtFailures.for_error(self.config.relative_error)
        if self.config.threshold is not None:
            return AtThreshold(self.config.threshold, plan.confidence)
        return None

    def _satisfied(self, state: McState) -> bool:
        """Whether enough is seen of every specification."""
        stopping = self._stopping(state.plan)
        if not (stopping and state.parts):
            return False
        error = np.concatenate([part.error for part in state.parts])
        violated = np.concatenate([part.violated for part in state.parts])
        return all(stopping.at(column, error) for column in violated.T)

    def _values(self, state: McState, violated: Bools) -> Floats:
        """(runs,) share of failures of each run."""
        runs = np.arange(len(violated)) // state.per_run
        return np.asarray(np.bincount(runs, weights=violated) / np.bincount(runs))

    def _failures(self, state: McState, violated: Any, robustness: Any) -> Failures:
        index = np.flatnonzero(violated)
        kept = index[:FAILURE_LIMIT]
        return Failures(self._tapes(state, kept), robustness[kept], len(index))

    def _worst(self, state: McState, robustness: Any) -> Worst:
        if np.isnan(robustness).all():
            return Worst(np.zeros((state.plan.steps + 1, state.plan.noise.noise_size)), math.nan)
        index = int(np.nanargmin(robustness))
        return Worst(self._tapes(state, np.array([index]))[0], float(robustness[index]))

    def _tapes(self, state: McState, index: Any) -> Any:
        """Noise (F, steps + 1, noise_size) of rollouts, drawn again from their addresses."""
        run, particle = np.divmod(index[:, None], state.per_run)
        return state.plan.noise.normals(run, 0, particle, np.arange(state.plan.steps + 1))


def _affordable(plan: Plan, config: McConfig) -> int:
    """Rollouts of each run that the budget pays for; for seconds the loop watches the clock."""
    budget = plan.budget
    assert budget is not None
    if budget.kind == "seconds":
        if config.runs > 1:
            raise UsageError(
                f"{config.runs} runs cannot share a budget of seconds: they must be of known size",
                "leave runs at 1, or give the budget as steps=N or rollouts=N",
            )
        return _UNLIMITED
    cost = max(plan.steps, 1) if budget.kind == "steps" else 1
    rollouts = int(budget.amount // (cost * config.runs))
    if rollouts < 1:
        raise UsageError(
            f"a budget of {budget.kind}={budget.amount:g} does not pay for {config.runs} run(s) of a rollout",
            f"one rollout costs {cost} {budget.kind}",
        )
    return rollouts
