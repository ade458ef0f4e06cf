"""Estimator ``mfmc``: Monte Carlo with two fidelities, a cheap twin on many tapes and the stack on few.

A pilot of both on the same tapes plans the design (``two_phase``), which is fixed before the rollouts that
count; it has a seed of its own and counts in no estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from avrare.base.errors import UsageError
from avrare.base.number_format import format_percent
from avrare.estimation.checks.result_builder import add_counts
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.counts import monte_carlo_cost
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import FAILURE_LIMIT, Execute, Settings
from avrare.estimation.result import health, intervals
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import Failures, Result, spread
from avrare.protocols import Bools, Floats
from avrare.rollout.child_process import run_guarded
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare.rollout.twin import Twin, check_twin, measure_cost
from avrare_estimators.two_fidelities.config import MfmcConfig
from avrare_estimators.two_fidelities.tape_recorder import Record, Recorder, draw_tapes, take_record
from avrare_estimators.two_fidelities.two_phase import Design, plan_design, scale_rates

_SEED_KEY = 0x2F1D


def build(config: MfmcConfig, scene: object | None = None) -> Mfmc:
    """Build the estimator."""
    return Mfmc(config)


class Mfmc(MonteCarlo):
    """Two-phase sampling with a cheap twin; whoever drives it step by step gets Monte Carlo.

    The estimation loop calls ``estimate_by``.
    """

    name = "mfmc"

    def __init__(self, config: MfmcConfig) -> None:
        self.options = config
        super().__init__(McConfig(rollouts=min(config.rollouts, 10**15)))

    def estimate_by(self, problem: Problem, settings: Settings, execute: Execute) -> list[Result]:
        """Return one result per specification, all from the same tapes."""
        if problem.twin is None:
            raise UsageError(
                "estimator mfmc needs a cheap twin of the stack",
                "name one in the scenario, for example `cheap: {cost: 0.1, controller: {search: follow}}`, "
                "or in Python problem.with_twin(cheap_problem, cost=0.1)",
            )
        check_twin(problem, problem.twin.problem, problem.twin.cost)
        total = self._total(problem, settings.budget)
        cost = _cost(problem, problem.twin)
        work = _Work(problem, problem.twin.problem.subset(problem.names), cost, settings, execute)
        return work.estimate(total, int(self.options.pilot * total / (1.0 + cost)))

    def _total(self, problem: Problem, budget: Budget | None) -> float:
        """Return the cost that may be spent, in rollouts of the stack."""
        if budget is None:
            return self.options.rollouts
        if budget.kind == "seconds":
            raise UsageError(
                "mfmc fixes its tapes before they run, and cannot be stopped by the clock",
                "give the budget as steps=N or rollouts=N",
            )
        total = budget.amount / (max(problem.steps, 1) if budget.kind == "steps" else 1)
        if total < 1.0:
            raise UsageError(f"a budget of {budget.kind}={budget.amount:g} does not pay for a rollout")
        return total


def _cost(problem: Problem, twin: Twin) -> float:
    if twin.cost is None:  # a measured one would make results differ from machine to machine
        measure = partial(measure_cost, problem, twin.problem)
        measured = run_guarded("the measurement of its cost", problem.system, measure)
        raise UsageError(
            "the cost of the cheap twin is missing, on which the split of the rollouts depends",
            f"name it: this machine measures `cheap: {{cost: {measured:g}}}`, in Python "
            f"problem.with_twin(cheap_problem, cost={measured:g})",
        )
    return twin.cost


@dataclass(frozen=True)
class _Spent:
    """Results of parts of the estimate; the specifications of a part share its rollouts."""

    parts: tuple[Result, ...] = ()

    def added_to(self, result: Result) -> Result:
        return replace(
            add_counts(result, [phase.counts for phase in self.parts]),
            rollouts=result.rollouts + sum(phase.rollouts for phase in self.parts),
            simulated_steps=result.simulated_steps + sum(phase.simulated_steps for phase in self.parts),
            seconds=result.seconds + sum(phase.seconds for phase in self.parts),
        )


@dataclass(frozen=True)
class _Work:
    problem: Problem
    twin: Problem
    cost: float
    settings: Settings
    execute: Execute

    def estimate(self, total: float, pilot: int) -> list[Result]:
        if pilot < 50:  # too few tapes to plan anything
            return self._plain(total, "too few rollouts for a pilot", _Spent())
        if self.cost >= 1.0:
            return self._plain(total, "the cheap twin costs as much as the stack", _Spent())
        # 1. The pilot: both on the same tapes.
        tapes, settings = np.arange(pilot), self._pilot_settings()
        stack = self.execute(self.problem, Recorder(tapes), settings, "pilot")
        others = self.execute(self.twin, Recorder(tapes), settings, "twin-pilot")
        seen, twin, spent = take_record(stack), take_record(others), _Spent((stack[0], others[0]))
        failed = seen.violated | seen.error[:, None]
        design = plan_design(twin.violated, twin.robustness, failed, self.cost)
        left = total - pilot * (1.0 + self.cost)
        if not design.pays:
            return self._plain(left, _refusal(design) + _describe_errors(others[0]), spent)
        # 2. What counts, as planned.
        return self._phases(design, left, spent, seen)

    def _phases(self, design: Design, left: float, spent: _Spent, seen: Record) -> list[Result]:
        count = int(left / (self.cost + design.rate))
        settings = replace(self.settings, budget=None)
        twin_results = self.execute(self.twin, Recorder(np.arange(count)), settings, "twin")
        twin = take_record(twin_results)
        rates, factor = scale_rates(design.rates(twin.violated, twin.robustness), left - count * self.cost)
        noise = NoiseSource(settings.seed, self.problem.noise_size)
        chosen = np.flatnonzero(noise.choices(0, 0, np.arange(count)) < rates)
        stack_results = self.execute(self.problem, Recorder(chosen), settings, "stack")
        weights = 1.0 / (count * rates[chosen])
        largest = [1.0 / (count * min(factor * float(band.rates.min()), 1.0)) for band in design.bands]
        spent = replace(spent, parts=(*spent.parts, twin_results[0]))
        return [
            self._result(result, column, design, count, chosen, weights, largest[column], spent, seen)
            for column, result in enumerate(stack_results)
        ]

    def _result(
        self,
        result: Result,
        column: int,
        design: Design,
        count: int,
        chosen: Integers,
        weights: Floats,
        largest: float,
        spent: _Spent,
        seen: Record,
    ) -> Result:
        record = take_record([result])
        violated, error = record.violated[:, column], record.error
        failure_weights = weights[violated]
        probability = math.fsum(failure_weights)
        variance = max(math.fsum(failure_weights**2) - probability**2 / count, 0.0)
        interval = partial(
            intervals.weighted_counts,
            failure_weights,
            count,
            largest,
            errors=weights[error] if error.any() else None,
        )
        text = self._describe(count, len(chosen), probability, variance) + _describe_errors(spent.parts[-1])
        estimate = replace(
            result,
            probability=min(probability, 1.0),
            run_probabilities=np.array([min(probability, 1.0)]),
            interval_at=interval,
            relative_error=math.sqrt(variance) / probability if probability else math.nan,
            failures=self._failures(chosen, violated, weights, record.robustness[:, column]),
            robustness=seen.robustness[:, column],
            health=result.health | self._check_errors(record, weights),
            diagnostics={
                "twin": {
                    **self._numbers(design, column),
                    "tapes": count,
                    "run_again": len(chosen),
                }
            },
            error_share=math.fsum(weights[error]),
            notes=(*result.notes, Note("twin", f"{text}.")),
        )
        return spent.added_to(estimate)

    def _check_errors(self, record: Record, weights: Floats) -> dict[str, str]:
        allowed, share = self.settings.max_error_rate, float(weights[record.error].sum())
        if share <= allowed:  # of fresh tapes: those that run again are no fair sample
            return {}
        return health.check_errors(int(record.error.sum()), len(record.error), 0.0, record.messages)

    def _failures(self, chosen: Integers, violated: Bools, weights: Floats, robustness: Floats) -> Failures:
        steps = self.problem.steps
        tape_bytes = 8 * (steps + 1) * max(self.problem.noise_size, 1)
        most = max(1, min(FAILURE_LIMIT, 2**28 // (tape_bytes * len(self.problem.names))))
        rows = spread(np.flatnonzero(violated), most)
        noise = NoiseSource(self.settings.seed, self.problem.noise_size)
        shares, count = weights[rows], int(violated.sum())
        if len(rows):
            shares = shares * (weights[violated].sum() / shares.sum())
        return Failures(draw_tapes(noise, steps, chosen[rows]), robustness[rows], count, shares)

    def _plain(self, total: float, reason: str, spent: _Spent) -> list[Result]:
        rollouts = max(1, int(total))
        settings = replace(self.settings, budget=None)
        results = self.execute(self.problem, MonteCarlo(McConfig(rollouts=rollouts)), settings, "mc")
        estimates = []
        for result in results:
            twin = {"cost": self.cost, "reason": reason}
            note = Note("twin", f"Plain Monte Carlo was run: {reason}.")
            counted = replace(
                result,
                error_share=result.errors / max(result.rollouts, 1),
                diagnostics={**result.diagnostics, "twin": twin},
                notes=(*result.notes, note),
            )
            estimates.append(spent.added_to(counted))
        return estimates

    def _describe(self, count: int, again: int, probability: float, variance: float) -> str:
        error = math.sqrt(variance) / probability if probability else math.nan
        needed = monte_carlo_cost(probability, error)
        paid = round(count * self.cost + again)
        text = (
            f"The cheap twin ran {count:,} tapes at {self.cost:.2g} of the cost, and {again:,} of them ran "
            f"again on the stack: as dear as {paid:,} rollouts"
        )
        return text if needed is None else f"{text}, where Monte Carlo would need about {needed:,}"

    def _numbers(self, design: Design, column: int) -> dict[str, object]:
        return {
            "cost": self.cost,
            "rate": design.rate,
            "foreseen_gain": float(design.gains[column]),
            "correlation": float(design.correlations[column]),
            "rates": design.bands[column].rates.tolist(),
            "limits": design.bands[column].limits.tolist(),
        }

    def _pilot_settings(self) -> Settings:
        seed = np.random.SeedSequence(self.settings.seed, spawn_key=(_SEED_KEY,)).generate_state(
            1, np.uint64
        )[0]
        return replace(self.settings, seed=int(seed), budget=None)


def _describe_errors(twin: Result) -> str:
    return f"; the twin broke down on {twin.errors:,} of {twin.rollouts:,} tapes" if twin.errors else ""


def _refusal(design: Design) -> str:
    gains = design.gains[~np.isnan(design.gains)]
    if not len(gains):
        return "the pilot met no failure, and could not plan with the cheap twin"
    least, cost = float(gains.min()), format_percent(design.cost)
    return f"a cheap twin at {cost} of the cost promises a gain of only {least:.2g} over Monte Carlo"
