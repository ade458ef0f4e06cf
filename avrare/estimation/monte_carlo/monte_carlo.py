"""Monte Carlo estimator, the reference for all others, with rules that stop it and keep its confidence."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.base.number_format import format_count
from avrare.estimation.checks.result_builder import build_result, represent_errors
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.counts import MOST_ROBUSTNESS, Counts
from avrare.estimation.plan.memory import Demand
from avrare.estimation.plan.plan import CostForecast, Estimator, Info, Plan
from avrare.estimation.result import health, intervals
from avrare.estimation.result.note import Note, describe_missed_goal, describe_stop
from avrare.estimation.result.result import Failures, Result, Worst
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Request, Rollouts


@dataclass(frozen=True)
class AtFailures:
    """Stop at a number m of failures fixed beforehand (inverse binomial sampling, Haldane 1945).

    The relative error is then at most 1 / sqrt(m - 2).
    """

    failures: int

    @staticmethod
    def for_error(relative_error: float) -> AtFailures:
        """Return the rule with enough failures for this relative error."""
        return AtFailures(math.ceil(relative_error**-2) + 2)

    def at(self, violated: Bools, error: Bools) -> int:
        """Return the number of rollouts after which the rule stops, 0 if it does not stop within these."""
        if violated.sum() < self.failures:
            return 0
        return int(np.flatnonzero(violated)[self.failures - 1]) + 1

    def value(self, violated: Bools, stop: int) -> float:
        """Return the unbiased estimate: after a stop the last failure was certain and does not count."""
        return float((violated.sum() - 1) / (stop - 1) if stop else violated.mean())

    def interval(self, stop: int) -> Callable[..., intervals.Interval]:
        """Return the exact interval ``(failures, trials, confidence, errors)``, with or without a stop."""
        return intervals.inverse_binomial if stop else intervals.clopper_pearson


@dataclass(frozen=True)
class AtThreshold:
    """Stop as soon as a confidence sequence excludes a threshold.

    The sequence is valid at all times at once (Robbins 1970), so it may be evaluated after every rollout:
    it is the set of p whose likelihood is not 1/(1 - confidence) times below that of a beta mixture around
    the threshold. Stopping biases the estimate away from the threshold; the interval remains valid.
    """

    threshold: float
    confidence: float  # of the decision

    def at(self, violated: Bools, error: Bools) -> int:
        """Return the first rollout after which the threshold is excluded, whatever the errors are, or 0."""
        count = np.arange(1, len(violated) + 1)
        pessimistic = violated | error
        below = self._exceeds_evidence(pessimistic) & (np.cumsum(pessimistic) < self.threshold * count)
        above = self._exceeds_evidence(violated) & (np.cumsum(violated) > self.threshold * count)
        decided = below | above
        return int(decided.argmax()) + 1 if decided.any() else 0

    def value(self, violated: Bools, stop: int) -> float:
        """Return the share of failures."""
        return float(violated.mean())

    def interval(self, stop: int) -> Callable[..., intervals.Interval]:
        """Return the interval of the sequence, whether it has stopped or not."""
        return partial(intervals.anytime, around=self.threshold)

    def _exceeds_evidence(self, failed: Bools) -> Bools:
        return np.asarray(self._log_evidence(failed) >= -math.log(1.0 - self.confidence))

    def _log_evidence(self, failed: Bools) -> Floats:
        # log likelihood ratio of mixture and threshold after each rollout, (n,)
        a, b = intervals.mixture(self.threshold)
        before = np.arange(len(failed))
        failures: Floats = np.cumsum(failed) - failed.astype(np.float64)
        surprise = np.where(
            failed,
            np.log((a + failures) / self.threshold),
            np.log((b + before - failures) / (1.0 - self.threshold)),
        )
        return np.asarray(np.cumsum(surprise - np.log(a + b + before)))


Stopping = AtFailures | AtThreshold
"""Stopping rule of one specification, with its estimate and interval."""

_STAGE = 2**15
"""Largest number of rollouts of a stage."""
FIRST_STAGE = 64
"""Rollouts before the first look at the clock; later stages double, so that each look is in time."""
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
    counts: Counts  # outcomes of the stages so far
    info: Info  # their totals


class MonteCarlo(Estimator):
    """Binomial estimate with the exact interval of Clopper and Pearson.

    With ``relative_error`` or ``threshold`` it stops by a rule that keeps its confidence
    (``stopping_rules``); stopping by a fixed-size interval would not. Each specification has its own stop:
    rollouts beyond it count in the cost, but not in the estimate.
    """

    name = "mc"
    single = False

    def __init__(self, config: McConfig) -> None:
        self.config = config
        self.stops_early = config.early_stop

    def scale(self, rollouts: float, probability: float) -> MonteCarlo:
        """Return Monte Carlo with this number of rollouts, at least one."""
        return MonteCarlo(McConfig(rollouts=max(1, int(rollouts))))

    def init(self, plan: Plan) -> tuple[McState, Info]:
        """Return the state before the first rollout, and the progress to show."""
        per_run = self.config.rollouts
        if plan.budget is not None:
            per_run = _affordable_rollouts(plan, self.config)
        open_ended = per_run == _UNLIMITED or self.config.sequential
        goal = None if open_ended else per_run * self.config.runs
        info = Info(goal=goal, forecast=self._forecast(plan, per_run, None))
        counts = Counts(per_run, plan.kept_failures, ordered=self.config.sequential)
        return McState(plan, per_run * self.config.runs, per_run, counts, info), info

    def demand(self, plan: Plan, carry: int) -> Demand:
        """Return the memory of the verdicts, the kept failures and one stage."""
        state, specs = self.init(plan)[0], len(plan.names)
        rows = 0 if state.info.goal is None and not self.config.sequential else state.total
        robustness = 16 * min(rows or MOST_ROBUSTNESS, MOST_ROBUSTNESS) * specs
        stage = 2 * min(_STAGE, rows or _STAGE) * (9 * specs + 9)
        verdicts = 2 * rows * (specs + 1) if self.config.sequential else 0
        return Demand(robustness + stage + verdicts, self.config.memory, "rollouts")

    def ask(self, state: McState) -> Request | None:
        """Return the next stage of independent rollouts, None when done."""
        done, size = state.info.rollouts, _STAGE
        if done >= state.total or self._has_stopped(state):
            return None
        if self.config.sequential:  # few rollouts are wasted, and few looks read all of them
            size = self._stage_rows(done)
        elif state.info.goal is None:
            size = min(size, max(FIRST_STAGE, done))
        index = np.arange(done, min(done + size, state.total))
        request = Request.from_start(index // state.per_run, index % state.per_run)
        return replace(request, stop_early=self.config.early_stop)

    def _stage_rows(self, done: int) -> int:
        """Return the rollouts up to the next look of a stopping rule, which overshoots by 1 / 16 at most."""
        return max(FIRST_STAGE, done // 16)

    def tell(self, state: McState, rollouts: Rollouts) -> tuple[McState, Info]:
        """Append the outcome of a stage."""
        info, counts = state.info.plus(rollouts), state.counts.plus(rollouts)
        state = replace(state, counts=counts, info=info)
        return state, replace(info, forecast=self._forecast(state.plan, state.total, counts))

    def estimate(self, state: McState) -> list[Result]:
        """Return one result per specification, all from the same rollouts."""
        stopping = self._stopping(state.plan)
        if stopping is None:
            return [self._estimate_from_all(state, column) for column in range(len(state.plan.names))]
        violated, error = state.counts.join_verdicts()
        return [
            self._estimate_from_stop(state, column, stopping, violated[:, column], error)
            for column in range(len(state.plan.names))
        ]

    def _estimate_from_all(self, state: McState, column: int) -> Result:
        counts = state.counts
        assert counts.failures is not None
        failures = int(counts.failures[:, column].sum())
        values = counts.probabilities(column)
        result = self._result(
            state, column, values, counts.trials, failures, counts.errors, intervals.clopper_pearson
        )
        return replace(result, trials=counts.trials)

    def _estimate_from_stop(
        self, state: McState, column: int, stopping: Stopping, violated: Bools, error: Bools
    ) -> Result:
        stop = stopping.at(violated, error)
        trials = stop or len(error)
        violated, errors = violated[:trials], int(error[:trials].sum())
        values, failures = np.array([stopping.value(violated, stop)]), int(violated.sum())
        result = self._result(state, column, values, trials, failures, errors, stopping.interval(stop))
        notes: tuple[Note, ...] = ()
        if not stop:
            notes = (describe_missed_goal(trials, f"with {failures:,} failure{'s' * (failures != 1)}"),)
        elif trials < state.counts.trials:
            notes = (describe_stop(trials, failures),)
        diagnostics = {"used_rollouts": trials, "goal_reached": bool(stop)}
        return replace(result, diagnostics=diagnostics, notes=(*result.notes, *notes))

    def _result(
        self,
        state: McState,
        column: int,
        values: Floats,
        trials: int,
        failures: int,
        errors: int,
        interval: Callable[..., intervals.Interval],
    ) -> Result:
        plan, counts, probability = state.plan, state.counts, float(values.mean())
        warnings = health.check_errors(errors, trials, plan.max_error_rate, counts.messages)
        if failures == trials:
            warnings |= health.warn("all_failed")
        first_failures, least = counts.failing[column].before(trials), counts.records[column].before(trials)
        worst = represent_errors(plan)
        if len(least.index):
            worst = Worst(self._tapes(state, least.index[-1:])[0], float(least.robustness[-1]))
        failed = probability > 0.0
        return build_result(
            plan,
            self.name,
            replace(state.info, errors=errors),
            values,
            interval_at=partial(interval, failures, trials, errors=errors),
            relative_error=math.sqrt((1 - probability) / (probability * trials)) if failed else math.nan,
            health=warnings,
            failures=Failures(self._tapes(state, first_failures.index), first_failures.robustness, failures),
            worst=worst,
            robustness=counts.join_robustness(column, trials),
            column=column,
        )

    def _forecast(self, plan: Plan, total: int, counts: Counts | None) -> CostForecast | None:
        """Return the rollouts until a stopping rule has enough failures of the rarest specification."""
        stopping = self._stopping(plan)
        if stopping is None:
            return None
        if not isinstance(stopping, AtFailures):
            return CostForecast("rollouts", 0.0, total)
        needed = stopping.failures
        if counts is None:
            return CostForecast("rollouts", min(needed, total), total)
        violated, error = counts.join_verdicts()
        failures, trials = int(violated.sum(axis=0).min()), len(error)
        low, high = intervals.clopper_pearson(failures, trials, plan.confidence)
        least, most = (min(needed / p if p else math.inf, total) for p in (high, low))
        return CostForecast("rollouts", least, most, f"{failures} of {needed} failures")

    def _stopping(self, plan: Plan) -> Stopping | None:
        if self.config.relative_error is not None:
            return AtFailures.for_error(self.config.relative_error)
        if self.config.threshold is not None:
            return AtThreshold(self.config.threshold, plan.confidence)
        return None

    def _has_stopped(self, state: McState) -> bool:
        stopping = self._stopping(state.plan)
        if not (stopping and state.counts.trials):
            return False
        violated, error = state.counts.join_verdicts()
        return all(stopping.at(column, error) for column in violated.T)

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
        runs = format_count(config.runs, "run")
        raise UsageError(
            f"a budget of {budget.kind}={budget.amount:g} does not pay for {runs} of a rollout",
            f"one rollout costs {cost} {budget.kind}",
        )
    return rollouts
