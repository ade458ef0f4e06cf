"""Monte Carlo estimator: the reference for all other estimators."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.estimation import health, intervals
from avrare.estimation.monte_carlo_config import McConfig
from avrare.estimation.plan import Info, Plan
from avrare.estimation.result import FAILURE_LIMIT, Failures, Result, Worst
from avrare.estimation.result_builder import build_result, missing_worst
from avrare.estimation.stopping_rules import AtFailures, AtThreshold, Stopping
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Request, Rollouts

_STAGE = 2**15
"""Largest number of rollouts of a stage."""
_FIRST_STAGE = 64
"""Rollouts before the first look at the clock; later stages double, so that each look is in time."""
_MORE, _LOOK = 4, 32
"""A stopping rule may overshoot by a quarter of the rollouts done, of many by 1 / 32."""
_UNLIMITED = 2**40
"""Rollouts of a run that a budget of seconds ends."""


def build(config: McConfig, scene: object | None = None) -> MonteCarlo:
    """Build the estimator."""
    return MonteCarlo(config)


@dataclass(frozen=True)
class McState:
    """State of Monte Carlo."""

    plan: Plan
    total: int  # rollouts to run, over all runs
    per_run: int  # rollouts of one run
    parts: tuple[Rollouts, ...]  # outcomes of the stages so far, in order
    info: Info  # totals of the parts


class MonteCarlo:
    """Binomial estimate with the exact interval of Clopper and Pearson.

    With ``relative_error`` or ``threshold`` it stops by a rule that keeps its confidence
    (``avrare.estimation.stopping_rules``); stopping by a fixed-size interval would not. Each specification
    has its own stop: rollouts beyond it count in the cost, but not in the estimate.
    """

    name = "mc"
    single = False

    def __init__(self, config: McConfig) -> None:
        self.config = config
        self.stops_early = config.early_stop

    def scaled(self, rollouts: float, probability: float) -> MonteCarlo:
        """Return Monte Carlo with this number of rollouts, at least one (``ScalesToCost``)."""
        return MonteCarlo(McConfig(rollouts=max(1, int(rollouts))))

    def init(self, plan: Plan) -> tuple[McState, Info]:
        """Return the state before the first rollout, and the progress to show."""
        per_run = self.config.rollouts
        if plan.budget is not None:
            per_run = _affordable_rollouts(plan, self.config)
        open_ended = per_run == _UNLIMITED or self.config.sequential
        goal = None if open_ended else per_run * self.config.runs
        info = Info(goal=goal)
        return McState(plan, per_run * self.config.runs, per_run, (), info), info

    def ask(self, state: McState) -> Request | None:
        """Return the next stage of independent rollouts, None when done."""
        done, size = state.info.rollouts, _STAGE
        if done >= state.total or self._all_stopped(state):
            return None
        if self.config.sequential:  # few rollouts are wasted, and few looks read all of them
            size = max(_FIRST_STAGE, min(size, done // _MORE), done // _LOOK)
        elif state.info.goal is None:
            size = min(size, max(_FIRST_STAGE, done))
        index = np.arange(done, min(done + size, state.total))
        request = Request.from_start(index // state.per_run, index % state.per_run)
        return replace(request, stop_early=self.config.early_stop)

    def tell(self, state: McState, rollouts: Rollouts) -> tuple[McState, Info]:
        """Append the outcome of a stage."""
        info = state.info.plus(rollouts)
        return McState(state.plan, state.total, state.per_run, (*state.parts, rollouts), info), info

    def estimate(self, state: McState) -> list[Result]:
        """Return one result per specification, all from the same rollouts."""
        outcome = Rollouts.join(list(state.parts))
        return [self._result(state, outcome, column) for column in range(len(state.plan.names))]

    def _result(self, state: McState, outcome: Rollouts, column: int) -> Result:
        plan = state.plan
        stopping = self._stopping(plan)
        stop = stopping.at(outcome.violated[:, column], outcome.error) if stopping else 0
        used = slice(0, stop or len(outcome.error))
        violated, error = outcome.violated[used, column], outcome.error[used]
        trials, failures, errors = len(error), int(violated.sum()), int(error.sum())
        values = self._run_probabilities(state, violated)
        if stopping:
            values = np.array([stopping.value(violated, stop)])
        probability = float(values.mean())
        robustness = np.where(error, np.nan, outcome.robustness[used, column])
        warnings = health.check_errors(errors, trials, plan.max_error_rate, outcome.messages)
        if failures == trials:
            warnings |= health.warn("all_failed")
        interval = stopping.interval(stop) if stopping else intervals.clopper_pearson
        known = probability > 0.0
        return build_result(
            plan, self.name, replace(state.info, errors=errors), values,
            interval_at=partial(interval, failures, trials, errors=errors),
            relative_error=math.sqrt((1 - probability) / (probability * trials)) if known else math.nan,
            health=warnings,
            failures=self._failures(state, violated, robustness),
            worst=self._worst(state, robustness),
            robustness=robustness,
            column=column,
            diagnostics={"used_rollouts": trials, "goal_reached": bool(stop)} if stopping else {},
        )  # fmt: skip

    def _stopping(self, plan: Plan) -> Stopping | None:
        if self.config.relative_error is not None:
            return AtFailures.for_error(self.config.relative_error)
        if self.config.threshold is not None:
            return AtThreshold(self.config.threshold, plan.confidence)
        return None

    def _all_stopped(self, state: McState) -> bool:
        stopping = self._stopping(state.plan)
        if not (stopping and state.parts):
            return False
        error = np.concatenate([part.error for part in state.parts])
        violated = np.concatenate([part.violated for part in state.parts])
        return all(stopping.at(column, error) for column in violated.T)

    def _run_probabilities(self, state: McState, violated: Bools) -> Floats:
        runs = np.arange(len(violated)) // state.per_run
        return np.asarray(np.bincount(runs, weights=violated) / np.bincount(runs))

    def _failures(self, state: McState, violated: Any, robustness: Any) -> Failures:
        index = np.flatnonzero(violated)
        kept = index[:FAILURE_LIMIT]
        return Failures(self._tapes(state, kept), robustness[kept], len(index))

    def _worst(self, state: McState, robustness: Any) -> Worst:
        if np.isnan(robustness).all():
            return missing_worst(state.plan)
        index = int(np.nanargmin(robustness))
        return Worst(self._tapes(state, np.array([index]))[0], float(robustness[index]))

    def _tapes(self, state: McState, index: Any) -> Any:
        run, particle = np.divmod(index[:, None], state.per_run)
        return state.plan.noise.normals(run, 0, particle, np.arange(state.plan.steps + 1))


def _affordable_rollouts(plan: Plan, config: McConfig) -> int:
    budget = plan.budget
    assert budget is not None
    if budget.kind == "seconds":
        if config.runs > 1:
            raise UsageError(
                f"{config.runs} runs cannot share a budget of seconds: they must be of known size",
                "leave runs at 1, or give the budget as steps=N or rollouts=N",
            )
        return _UNLIMITED  # the loop watches the clock
    cost = max(plan.steps, 1) if budget.kind == "steps" else 1
    rollouts = int(budget.amount // (cost * config.runs))
    if rollouts < 1:
        raise UsageError(
            f"a budget of {budget.kind}={budget.amount:g} does not pay for {config.runs} run(s) of a rollout",
            f"one rollout costs {cost} {budget.kind}",
        )
    return rollouts
