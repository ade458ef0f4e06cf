"""Estimator ``auto``: a Monte Carlo pilot of all specifications, then the estimator that suits each of them.

Pilot, learning and trials draw from seeds of their own and count in no estimate, only in the cost. The
pilot's rollouts also count in the blind bound and in the checks of the chosen estimator: they see every
failure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pkgutil import resolve_name
from typing import Any

import numpy as np

from avrare.estimation.checks.result_builder import add_counts
from avrare.estimation.choice.auto_config import AutoConfig
from avrare.estimation.choice.auto_rules import (
    FEW_FAILURES,
    FIRST_SHARE,
    GOAL,
    LEAST_SECOND,
    ROLLOUTS,
    Aim,
    forecast_gain,
    pays,
)
from avrare.estimation.combine.witnesses import in_doubt, reconcile
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.counts import monte_carlo_cost
from avrare.estimation.monte_carlo.monte_carlo import FIRST_STAGE, AtFailures, MonteCarlo, Stopping
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Estimator, Execute, GaveUp, Plan, Refused, Settings
from avrare.estimation.result.confidence_distributions import (
    Binomial,
    InverseBinomial,
    derive_distribution,
)
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import Result
from avrare.plugin.component import AutoRole, Component
from avrare.plugin.registry import default_registry
from avrare.rollout.problem import Problem

_SEED_KEY = 0xA070
_PHASES = ("pilot", "learning", "trial", "witness", "again")
"""Phases with seeds of their own; what counts has the seed of the estimate, except for learning, which counts
only rows of stages that come later."""
_TRIAL = 2000
"""Most rollouts of a trial."""


def build(config: AutoConfig, scene: object | None = None) -> Auto:
    """Build the estimator."""
    return Auto(config)


class Auto(MonteCarlo):
    """Choice among the installed estimators; whoever drives it step by step gets Monte Carlo.

    The estimation loop calls ``estimate_by``.
    """

    name = "auto"

    def __init__(self, config: AutoConfig) -> None:
        self.choice = config
        options = config.model_dump() | {"rollouts": config.rollouts or ROLLOUTS}
        super().__init__(McConfig(**options))

    def estimate_by(self, problem: Problem, settings: Settings, execute: Execute) -> list[Result]:
        """Return one result per specification, by the estimator that suits it."""
        aim, refusal = self._aim(problem, settings)
        work = _Work(problem, settings, execute, aim, self.choice)
        if refusal:
            return [work.add_choice(result, refusal, []) for result in work.plain()]
        return work.estimate()

    def _aim(self, problem: Problem, settings: Settings) -> tuple[Aim, str]:
        """Return the aim, and why no pilot is worth its cost (empty where it is)."""
        choice, budget = self.choice, settings.budget
        goal, rollouts = choice.relative_error, float(choice.rollouts or ROLLOUTS)
        if goal is None and choice.rollouts is None and budget is None:
            goal = settings.goal or GOAL
        if budget is not None and budget.kind != "seconds":
            cost = max(problem.steps, 1) if budget.kind == "steps" else 1
            most = budget.amount / cost
            rollouts = min(rollouts, most) if choice.rollouts is not None else most
        aim = Aim(goal, rollouts)
        if choice.threshold is not None:
            return aim, "only Monte Carlo stops at a threshold"
        if budget is not None and budget.kind == "seconds":
            return aim, "only Monte Carlo can be stopped by the clock"
        if not problem.noise_size:
            return aim, "there is no noise, so that all rollouts are alike"
        if aim.small:
            return aim, "too few rollouts are allowed to choose from a pilot"
        return aim, ""


class _Pilot(MonteCarlo):
    """Monte Carlo until each specification has some failures, or up to a number of rollouts."""

    def __init__(self, aim: Aim, memory: float | None) -> None:
        super().__init__(McConfig(rollouts=aim.pilot, relative_error=0.5, early_stop=True, memory=memory))
        self.failures = aim.failures

    def _stopping(self, plan: Plan) -> Stopping:
        return AtFailures(self.failures)

    def _stage_rows(self, done: int) -> int:
        return max(FIRST_STAGE, done)  # few requests, of which at most the half is in vain


@dataclass(frozen=True)
class _Attempt:
    """Attempt at a specification that did not count."""

    estimator: str
    reason: str
    rollouts: int = 0
    steps: int = 0
    seconds: float = 0.0
    errors: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)

    @staticmethod
    def of(result: Result, reason: str) -> _Attempt:
        return _Attempt(
            result.estimator,
            reason,
            result.rollouts,
            result.simulated_steps,
            result.seconds,
            result.errors,
            result.counts,
        )

    @staticmethod
    def of_failure(estimator: str, end: GaveUp) -> _Attempt:
        info = end.info
        return _Attempt(
            estimator, end.message, info.rollouts, info.steps, end.seconds, info.errors, info.counts
        )


@dataclass(frozen=True)
class _Work:
    problem: Problem
    settings: Settings
    execute: Execute
    aim: Aim
    config: AutoConfig

    def estimate(self) -> list[Result]:
        # 1. The pilot decides who is frequent enough for Monte Carlo, on one set of rollouts.
        pilot = _Pilot(self.aim, self.config.memory)
        seen = self.execute(self.problem, pilot, self._of_phase("pilot"), "pilot")
        evidence = {result.specification: _count_outcomes(result) for result in seen}
        before = [_Attempt.of(seen[0], "pilot")]
        frequent = [name for name, counts in evidence.items() if self.aim.is_frequent(counts)]
        # 2. Those share rollouts again; the others are taken one by one.
        results: dict[str, Result] = {}
        if frequent:
            group = self.problem.subset(frequent)
            for result in self._monte_carlo(group, before, "mc"):
                reason = self.aim.describe(evidence[result.specification])
                results[result.specification] = self.add_choice(result, reason, before)
        for name, counts in evidence.items():
            if name not in results:
                results[name] = self._estimate_rare(self.problem.subset([name]), counts, before)
        return [results[name] for name in self.problem.names]

    def plain(self) -> list[Result]:
        """Return the results of Monte Carlo without a pilot."""
        return self._monte_carlo(self.problem, [], "mc")

    def add_choice(self, result: Result, reason: str, spent: Sequence[_Attempt]) -> Result:
        """Return a result with the cost of the earlier attempts, and why its estimator was chosen."""
        choice = {
            "estimator": result.estimator,
            "reason": reason,
            "tried": [
                {
                    "estimator": attempt.estimator,
                    "reason": attempt.reason,
                    "rollouts": attempt.rollouts,
                    "steps": attempt.steps,
                }
                for attempt in spent
            ],
            "counting_rollouts": result.rollouts,
            "monte_carlo_rollouts": monte_carlo_cost(result.probability, result.relative_error),
        }
        rollouts = result.rollouts + sum(attempt.rollouts for attempt in spent)
        text = f"Estimator `{result.estimator}` was chosen: {reason}{_describe_cost(result, rollouts)}."
        complete = add_counts(result, [attempt.counts for attempt in spent])
        return replace(
            complete,
            rollouts=rollouts,
            simulated_steps=result.simulated_steps + sum(attempt.steps for attempt in spent),
            errors=result.errors + sum(attempt.errors for attempt in spent),
            seconds=result.seconds + sum(attempt.seconds for attempt in spent),
            notes=(*complete.notes, Note("choice", text)),
            diagnostics={**result.diagnostics, "choice": choice},
        )

    def _estimate_rare(self, problem: Problem, evidence: FreshRows, before: list[_Attempt]) -> Result:
        spent, reason = list(before), self.aim.describe(evidence)
        first = self._first_witness(problem, evidence, spent)
        if first is None:  # nothing pays
            tried = ", ".join(attempt.estimator for attempt in spent[1:]) or "nothing else that is installed"
            (result,) = self._monte_carlo(problem, spent, f"{problem.names[0]}+mc")
            return self.add_choice(result, f"{reason}; tried in vain: {tried}", spent)
        # 4. What leaves a doubt is not accepted while budget is left: an unlike witness answers it.
        together = [*spent, _Attempt.of(first, "")]
        if self._rollouts_left(problem, together) < LEAST_SECOND or not (
            self.aim.goal is None or in_doubt(first)
        ):
            return self.add_choice(first, reason, spent)
        second = self._second_witness(first, problem, together)
        result, outcome, words = reconcile(first, second, self.settings.confidence)
        together.append(_Attempt.of(second, ""))
        if outcome == "disagree" and self._rollouts_left(problem, together) >= LEAST_SECOND:
            # 5. They disagree: the one that finds more must find it again, on rollouts of its own.
            less, more = sorted((first, second), key=lambda witness: witness.probability)
            attempts = list(together)
            enlarged = self._repeat(more, problem, attempts)
            spent += attempts[len(together) :]
            if enlarged is not None:
                spent.append(_Attempt.of(less, f"finds less than {more.estimator}"))
                result, _, words = reconcile(more, enlarged, self.settings.confidence)
        return self.add_choice(result, f"{reason}; {words}", spent)

    def _repeat(self, witness: Result, problem: Problem, spent: list[_Attempt]) -> Result | None:
        """Return a second estimate by a method, from the rest of the budget; None if it gives up."""
        settings = replace(self._of_phase("again"), budget=self._budget(problem, spent))
        for component, role in default_registry().candidates():
            if component.name == witness.estimator:
                return self._run("again", self._build(component, role), problem, settings, spent)
        return None

    def _first_witness(self, problem: Problem, evidence: FreshRows, spent: list[_Attempt]) -> Result | None:
        # 3. A candidate that gives up by itself just begins; a small trial decides on any other.
        for component, role in filter(
            lambda pair: pair[1].fits(problem.steps), default_registry().candidates()
        ):
            estimator = self._build(component, role)
            if role.gives_up or self._promises_gain(estimator, problem, evidence, spent):
                settings = self._of_phase("learning") if role.gives_up else self.settings
                budget = self._first_budget(problem, estimator.name, spent)
                settings = replace(settings, budget=budget, seen=evidence)
                result = self._run(estimator.name, estimator, problem, settings, spent)
                if result is not None:
                    return result
        return None

    def _second_witness(self, first: Result, problem: Problem, spent: list[_Attempt]) -> Result:
        """Return an estimate by another method from the rest of the budget.

        It is Monte Carlo, which sees every failure, where that is to meet some or nothing is in doubt.
        """
        settings = replace(self._of_phase("witness"), budget=self._budget(problem, spent))
        failures = first.probability * self._rollouts_left(problem, spent)
        unlike = in_doubt(first) and failures < FEW_FAILURES
        for component, role in _list_unlike(problem, first.estimator) if unlike else ():
            name = f"witness-{component.name}"
            second = self._run(name, self._build(component, role), problem, settings, spent)
            if second is not None:
                return second
        # Monte Carlo by the seed of the estimate would begin with the tapes of the first witness.
        work = replace(self, settings=replace(self.settings, seed=settings.seed))
        (counted,) = work._monte_carlo(problem, spent, f"{problem.names[0]}+witness-mc")
        return counted

    def _promises_gain(
        self, estimator: Estimator, problem: Problem, evidence: FreshRows, spent: list[_Attempt]
    ) -> bool:
        rollouts = min(_TRIAL, self.aim.pilot)
        if not self.aim.may_try(rollouts + self.aim.rollouts - self._rollouts_left(problem, spent), evidence):
            return False
        sized = estimator.scale(rollouts, max(evidence.failures, 0.3) / evidence.rows)
        if sized is None:
            return False
        trial = self._run(f"try-{estimator.name}", sized, problem, self._of_phase("trial"), spent)
        if trial is None:
            return False
        cost = trial.simulated_steps / problem.steps if problem.steps else trial.rollouts
        gain = forecast_gain(evidence, trial.probability, trial.relative_error, cost)
        spent.append(_Attempt.of(trial, f"a trial promises a gain of {gain:.2g} over Monte Carlo"))
        return pays(gain)

    def _run(
        self, part: str, estimator: Estimator, problem: Problem, settings: Settings, spent: list[_Attempt]
    ) -> Result | None:
        try:
            return self.execute(problem, estimator, settings, f"{problem.names[0]}+{part}")[0]
        except Refused as error:
            spent.append(_Attempt(estimator.name, error.message))
        except GaveUp as end:
            spent.append(_Attempt.of_failure(estimator.name, end))
        return None

    def _monte_carlo(self, problem: Problem, spent: Sequence[_Attempt], name: str) -> list[Result]:
        config, budget = self.config, self.settings.budget
        options: dict[str, Any] = {"memory": config.memory}
        if config.threshold is not None:
            options |= {"threshold": config.threshold}
            options |= {"rollouts": config.rollouts} if config.rollouts else {}
        else:
            options |= {"relative_error": self.aim.goal, "rollouts": self._rollouts_left(problem, spent)}
        if budget is not None and budget.kind != "seconds":
            budget = self._budget(problem, spent)
        return self.execute(
            problem, MonteCarlo(McConfig(**options)), replace(self.settings, budget=budget), name
        )

    def _rollouts_left(self, problem: Problem, spent: Sequence[_Attempt]) -> int:
        """Return the complete rollouts that are left."""
        budget = self._budget(problem, spent)
        return int(budget.amount / (problem.steps if budget.kind == "steps" else 1))

    def _first_budget(self, problem: Problem, name: str, spent: Sequence[_Attempt]) -> Budget:
        """Return the budget of a first witness, which leaves an unlike one enough of a large budget.

        It never falls as the budget grows, so that more rollouts find what fewer do.
        """
        budget, left = self._budget(problem, spent), self._rollouts_left(problem, spent)
        share = max(FIRST_SHARE, LEAST_SECOND / (1.0 - FIRST_SHARE) / left)
        alone = share >= 1.0 or not _list_unlike(problem, name)
        return budget if alone else replace(budget, amount=share * budget.amount)

    def _budget(self, problem: Problem, spent: Sequence[_Attempt]) -> Budget:
        rollouts = max(1.0, self.aim.rollouts - sum(attempt.rollouts for attempt in spent))
        budget = self.settings.budget
        if not problem.steps or (budget is not None and budget.kind == "rollouts"):
            return Budget("rollouts", rollouts)
        steps = self.aim.rollouts * problem.steps - sum(attempt.steps for attempt in spent)
        return Budget("steps", max(float(problem.steps), steps))

    def _of_phase(self, phase: str) -> Settings:
        key = (_SEED_KEY, _PHASES.index(phase))
        seed = np.random.SeedSequence(self.settings.seed, spawn_key=key).generate_state(1, np.uint64)[0]
        return replace(self.settings, seed=int(seed), budget=None)

    def _build(self, component: Component, role: AutoRole) -> Estimator:
        model, goal = component.load_config(), self.aim.goal
        shared = {"memory": self.config.memory} | ({} if goal is None else {"relative_error": goal})
        options = {name: value for name, value in shared.items() if name in model.model_fields}
        if role.options:
            options |= resolve_name(role.options)(goal, self.aim.pilot)
        return component.build(model(**options))  # type: ignore[no-any-return]


def _list_unlike(problem: Problem, name: str) -> list[tuple[Component, AutoRole]]:
    """Return the candidates that could be a second witness after an estimator."""
    return [
        (component, role)
        for component, role in default_registry().candidates()
        if role.fits(problem.steps) and not role.gives_up and component.name != name
    ]


def _count_outcomes(pilot: Result) -> FreshRows:
    """Return the rollouts up to the stop of a pilot, which its interval counts."""
    law = derive_distribution(pilot)
    assert isinstance(law, Binomial | InverseBinomial)
    return FreshRows(law.trials, law.failures, law.undecided)


def _describe_cost(result: Result, rollouts: int) -> str:
    if rollouts == result.rollouts:
        return ""
    text = f"; {rollouts - result.rollouts:,} of {rollouts:,} rollouts went into the choice"
    needed = monte_carlo_cost(result.probability, result.relative_error)
    if result.estimator == "mc" or needed is None:
        return text
    return f"{text}, and Monte Carlo would need about {needed:,} for the same relative error"
