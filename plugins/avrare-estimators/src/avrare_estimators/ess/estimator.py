"""Elliptical slice sampling: the probability of failure as a product over nested levels (stl-ess).

A pilot of few chains finds the levels and tunes the kernel; a second pass with fresh samples follows these
levels, and counts. Given the pilot, the second pass is unbiased: its levels and kernels depend on nothing
that it draws. All runs advance as one batch, each at its own levels.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from avrare.base.memory import allowance
from avrare.estimation.plan.memory import Demand
from avrare.estimation.plan.plan import CostForecast, Estimator, Info, Plan
from avrare.estimation.result.result import Result
from avrare.protocols import System, overrides
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare_estimators.common.chains.kernel import Kernel
from avrare_estimators.common.chains.level_pass import LevelPass, PassShape
from avrare_estimators.common.chains.pcn import PcnKernel
from avrare_estimators.common.cost import affordable_runs, paid_runs
from avrare_estimators.common.looks import LIKELY, MOST_GROWTH, RARE, Looks, Pilot
from avrare_estimators.ess.config import NestedLevelsConfig
from avrare_estimators.ess.state import EssState
from avrare_estimators.ess.summary import summarise

_NOMINAL = 1e-4
"""Probability that a run is taken to go down to, for budgets."""
_PILOT_SHARE = 0.5
"""Share of a budget that pilots take at most."""
_TAPES, _SAMPLE = 4.0, 400
"""Tapes of each sample of a run at its peak (old, new and the chains'), and other bytes."""


class NestedLevels(Estimator):
    """Estimator ``ess``.

    Args:
        config: Options.
        kernel: Moves the chains.

    Attributes:
        warnings: Health warnings that the system wants on every result.
    """

    name = "ess"
    single = True
    final_scores = True
    needs = ("noise",)
    warnings: Mapping[str, str] = {}

    def __init__(self, config: NestedLevelsConfig, kernel: Kernel) -> None:
        self.config, self.kernel = config, kernel

    def prepare(self, problem: Problem) -> Problem:
        """Return the problem, with its weights if it has any."""
        self.warnings = problem.system.warnings
        return _with_weights(problem)

    def init(self, plan: Plan) -> tuple[EssState, Info]:
        """Return the state before the first rollout, and its progress."""
        config, rollouts = self.config, self._nominal_rollouts(1)
        affordable_runs(plan, config.most, "nested levels", rollouts, rollouts, f"{config.chains} chains")
        most, first = self._most_runs(plan, 1), self._first_runs(plan)
        looks = None if config.second_pass else Looks.until(config.relative_error, first, most)
        runs = min(first, self._batch(plan, self._most_growth(plan)))
        state = EssState.begin(plan, self._pilot(plan, runs), looks)
        return state, Info(forecast=self._forecast(state))

    def demand(self, plan: Plan, carry: int) -> Demand:
        """Return the memory of the runs that advance together; runs that a pilot lets grow take more."""
        runs = min(self._first_runs(plan), self._batch(plan, self._most_growth(plan)))
        return Demand(runs * self._run_bytes(plan, 1), self.config.memory, "chains")

    def ask(self, state: EssState) -> Request | None:
        """Ask for the fresh tapes of a pass, then for the proposals of all waiting chains."""
        proposal = state.level_pass.proposal
        return None if proposal is None else Request.replay(proposal)

    def tell(self, state: EssState, rollouts: Rollouts) -> tuple[EssState, Info]:
        """Advance chains and levels; after the pilot begin the pass that counts."""
        state = state.tell(rollouts)
        if state.level_pass.proposal is None:
            state = self._continue(state) if state.counting else self._begin_counting(state)
        return state, replace(_info(state), forecast=self._forecast(state))

    def estimate(self, state: EssState) -> list[Result]:
        """Return the mean of the runs with its interval."""
        return [self._summary(state)]

    def scale(self, rollouts: float, probability: float) -> NestedLevels | None:
        """Return one run without a pilot, as long as the rollouts pay for it.

        Its error comes from its chains: several smaller runs would say less, with few degrees of freedom.
        """
        config = NestedLevelsConfig(runs=1, second_pass=False)
        moves = math.log(probability) / math.log(config.level_probability)
        chains = int(rollouts / (config.length + moves * (config.length - 1)))
        if chains < 10:  # the error of a single run would not be known
            return None
        sized = config.model_copy(update={"chains": min(chains, 1_000_000)})
        return NestedLevels(sized, PcnKernel())

    def _forecast(self, state: EssState) -> CostForecast:
        """Return the rollouts of the whole estimate: for two probabilities, then by the pilot's levels."""
        if state.pilot is not None and state.looks is not None:
            share = self._shape(1, second=False).chains / self.config.chains
            return state.pilot.forecast("rollouts", state.looks, state.runs, pilots=share * state.pilot.cost)
        looks = state.looks or Looks.until(
            self.config.relative_error, self._first_runs(state.plan), self._most_runs(state.plan, 1)
        )
        least = looks.runs[0] * self._nominal_rollouts(1, LIKELY)
        growth = self._most_growth(state.plan) if state.looks is None else 1
        most = looks.runs[-1] * self._nominal_rollouts(growth, RARE)
        return CostForecast("rollouts", least, most, f"p {LIKELY:g} .. {RARE:g}")

    def _summary(self, state: EssState) -> Result:
        return summarise(self.name, self.kernel, state, self.warnings, self.config.grows)

    def _pilot(self, plan: Plan, runs: int) -> LevelPass:
        shape = self._shape(runs, second=False)
        share = _PILOT_SHARE if self.config.second_pass else 1.0
        most = self._most_levels(plan, shape, share * self._share_of_budget(plan, runs))
        return LevelPass.begin(plan, shape, self.kernel, None, most)

    def _share_of_budget(self, plan: Plan, runs: int, growth: int = 1) -> float:
        """Return the rollouts of the budget for ``runs`` runs."""
        if plan.budget is None:
            return math.inf
        unit = max(plan.steps, 1) if plan.budget.kind == "steps" else 1
        return plan.budget.amount / unit * min(1.0, runs / self._most_runs(plan, growth))

    def _most_levels(self, plan: Plan, shape: PassShape, rollouts: float) -> float:
        """Return the levels that a pass with these rollouts may have at most."""
        if math.isinf(rollouts):
            return math.inf
        return max(1, int((rollouts / shape.runs - shape.samples) / (shape.moves * self.kernel.rollouts)))

    def _begin_counting(self, state: EssState) -> EssState:
        """Follow the levels of the pilot; the first one also decides how many runs, and how large."""
        pilot, spent = state.level_pass, state.pilot_rollouts + state.tally.rollouts - state.begun
        if state.looks is None:
            state = self._plan_runs(state)
        growth = state.pilot.growth if state.pilot else 1
        shape = self._shape(pilot.shape.runs, second=True, growth=growth)
        left = self._share_of_budget(pilot.plan, shape.runs, growth) - (spent - state.pilot_rollouts)
        most = self._most_levels(pilot.plan, shape, left)
        second = LevelPass.begin(pilot.plan, shape, self.kernel, pilot.levels, most)
        return replace(state, counting=True, level_pass=second, pilot_rollouts=spent)

    def _plan_runs(self, state: EssState) -> EssState:
        config, result, runs = self.config, self._summary(state), state.level_pass.shape.runs
        larger = config.chains / state.level_pass.shape.chains
        # A run keeps one root at least, so that few of them promise fewer still among more chains.
        roots = (statistics.median(result.diagnostics["roots"]) - 0.5) * larger if result.probability else 0.0
        rollouts = state.tally.rollouts
        pilot = Pilot(
            rollouts, roots, result.relative_error**2 * runs / larger, cost=rollouts * larger / runs
        )
        # With a budget, larger runs are fewer.
        first_runs = self._first_runs(state.plan)
        growth = min(pilot.wanted_growth, self._most_growth(state.plan))
        while growth > 1 and self._most_runs(state.plan, growth) < first_runs:
            growth -= 1
        pilot, most = replace(pilot, growth=growth), self._most_runs(state.plan, growth)
        first = (
            pilot.first_look(config.relative_error, first_runs, most) if config.relative_error else first_runs
        )
        return replace(state, pilot=pilot, looks=Looks.until(config.relative_error, first, most))

    def _continue(self, state: EssState) -> EssState:
        """Begin a batch of further runs where they are wanted."""
        state = state.join_batches()
        assert state.looks is not None
        runs = state.level_pass.shape.runs
        more = state.looks.missing(runs, lambda: self._summary(state).relative_error)
        if not more:
            return state
        more = min(more, self._batch(state.plan, state.pilot.growth if state.pilot else 1))
        noise = NoiseSource(state.plan.noise.seed, state.plan.noise.noise_size, first_run=runs)
        return state.next_batch(
            self._pilot(replace(state.plan, noise=noise), more), counting=not self.config.second_pass
        )

    def _first_runs(self, plan: Plan) -> int:
        """Return the runs before the first decision on more."""
        config, most = self.config, self._most_runs(plan, 1)
        return min(config.runs, most) if config.relative_error or config.grows else most

    def _most_growth(self, plan: Plan) -> int:
        fits = [growth for growth in range(2, MOST_GROWTH + 1) if self._batch(plan, growth, least=0)]
        return max(fits, default=1) if self.config.grows else 1

    def _batch(self, plan: Plan, growth: int, least: int = 1) -> int:
        """Return the number of runs that may advance together."""
        return max(least, allowance(self.config.memory) // self._run_bytes(plan, growth))

    def _run_bytes(self, plan: Plan, growth: int) -> int:
        shape = self._shape(1, second=True, growth=growth)
        return math.ceil(shape.samples * (_TAPES * plan.tape_bytes + _SAMPLE))

    def _most_runs(self, plan: Plan, growth: int) -> int:
        rollouts, most = self._nominal_rollouts(growth), self.config.most
        if plan.budget is None:
            return most
        paid = paid_runs(plan, rollouts, rollouts)
        return paid if self.config.relative_error is None else min(paid, most)

    def _shape(self, runs: int, second: bool, growth: int = 1) -> PassShape:
        config, chains = self.config, self.config.chains * growth
        if config.second_pass and not second:
            chains = min(chains, max(5, math.ceil(config.pilot * chains)))
        samples = chains * config.length
        survivors = min(max(1, round(config.level_probability * samples)), samples - 1)
        second_stage = 2**31
        stage = second_stage if second else 0
        return PassShape(
            runs=runs,
            chains=chains,
            length=config.length,
            skip=config.skip,
            survivors=survivors,
            floor=config.floor,
            stage=stage,
        )

    def _nominal_rollouts(self, growth: int, probability: float = _NOMINAL) -> int:
        shares = math.ceil(math.log(probability) / math.log(self.config.level_probability))
        passes = (False, True) if self.config.second_pass else (False,)
        shapes = [self._shape(1, second, growth if second else 1) for second in passes]
        moves = sum(shape.moves for shape in shapes)
        fresh = sum(shape.samples for shape in shapes)
        return fresh + math.ceil((shares - 1) * moves * self.kernel.rollouts)


def _with_weights(problem: Problem) -> Problem:
    if not overrides(problem.system, System.with_weights):
        return problem
    monitors = dict(zip(problem.names, problem.monitors, strict=True))
    score: Any = problem.score
    system = problem.system.with_weights()
    return Problem(system, monitors, problem.steps, chunk=problem.named_chunk).rescore(score)


def _info(state: EssState) -> Info:
    levels, current = state.level_pass.levels, state.level_pass
    last = np.sort(levels[-1].level[levels[-1].passed]) if levels else np.zeros(0)
    return replace(
        state.tally,
        stage=len(levels),
        level=float(last[len(last) // 2]) if len(last) else None,
        probability=float(current.probabilities.mean()) if current.population is not None else None,
        particles=int(current.active.sum()) * current.shape.samples if current.active.any() else None,
    )
