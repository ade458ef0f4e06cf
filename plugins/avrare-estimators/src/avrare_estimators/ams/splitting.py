"""Adaptive multilevel splitting over online monitors (stl-ams, section III-B)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from avrare.base.memory import allowance
from avrare.estimation.plan.memory import Demand
from avrare.estimation.plan.plan import CostForecast, Estimator, Info, Plan
from avrare.estimation.result.result import Result
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers, Request, Rollouts
from avrare_estimators.ams.config import AmsConfig
from avrare_estimators.ams.forecast import forecast_cost
from avrare_estimators.ams.leaps import Leaps
from avrare_estimators.ams.levels import choose_parents, first_above, next_level
from avrare_estimators.ams.population import Branches
from avrare_estimators.ams.state import AmsState, run_bytes
from avrare_estimators.ams.summary import summarise
from avrare_estimators.common.cost import affordable_runs
from avrare_estimators.common.looks import LEAST_RUNS, MOST_GROWTH, Looks, Pilot

_STEPS_OF_RUN, _ROLLOUTS_OF_RUN = 4, 10
"""Cost of a run in multiples of its first stage, for budgets (docs/statistics.md)."""
_NOMINAL = 1e-4
"""Probability at which a run costs that much."""
_PILOT_SHARE = 0.25
"""Share of a budget that a pilot takes at most."""


class Splitting(Estimator):
    """Estimator ``ams``: R runs of N particles as one batch."""

    name = "ams"
    single = True
    needs = ("branches",)
    rebuilds_carries = True

    def __init__(self, config: AmsConfig) -> None:
        self.config = config
        self.stops_early = config.early_stop

    def init(self, plan: Plan) -> tuple[AmsState, Info]:
        """Return the state before the first rollout, and its progress."""
        self._most_runs(plan)  # refuses a budget that does not pay
        if self.config.grows and plan.steps and self._most_runs(plan, 1) >= LEAST_RUNS:
            # far from the noise of the runs that count
            state = AmsState.begin(plan, 1, self.config.particles, first_run=2**31)
        else:
            state = self._begin_counting(plan)
        return state, Info(forecast=self._forecast(state))

    def scale(self, rollouts: float, probability: float) -> Splitting | None:
        """Return one run of as many particles as the rollouts pay for.

        Its error comes from its genealogy: several smaller runs would say less, with few degrees of freedom.
        """
        stages = 1.0 + (_STEPS_OF_RUN - 1.0) * math.log(probability) / math.log(_NOMINAL)
        particles = int(rollouts / stages)
        if particles < 50:  # the error of a single run would not be known
            return None
        discard = max(1, particles // 10)
        return Splitting(AmsConfig(runs=1, particles=particles, discard=discard))

    def ask(self, state: AmsState) -> Request | None:
        """Ask for the first N rollouts of every run, then for the successors of the discarded."""
        pending = state.pending
        if not len(pending.slots):
            return None
        run, particle = np.divmod(pending.slots, state.particles)
        stage = np.full(len(pending.slots), state.stage)
        request = Request(
            run + state.first_run,
            stage,
            particle,
            pending.start,
            keep_carries=True,
            every=state.every,
            stop_early=self.config.early_stop,
        )
        if not state.stage:
            return replace(request, most_bytes=self._bytes_per_slot(state))
        branch = pending.parents, pending.start, state.every
        return replace(request, carries=state.population.branch(*branch), past=state.population.past(*branch))

    def tell(self, state: AmsState, rollouts: Rollouts) -> tuple[AmsState, Info]:
        """Store the rollouts, then do one stage of all active runs (stl-ams, Algorithm 2)."""
        self._store(state, rollouts)
        if state.stage == 0:
            first = np.where(rollouts.error, np.nan, rollouts.robustness[:, 0])
            first = np.concatenate([state.first, first])
            leaps = state.leaps + Leaps.of(rollouts.scores[~rollouts.error])
            state = replace(
                state, every=rollouts.every, first=first, fresh=state.fresh.plus(rollouts), leaps=leaps
            )
        saved = state.saved + state.pending.steps(state.plan.steps, state.every) - rollouts.simulated_steps
        state = replace(state, tally=state.tally.plus(rollouts), stage=state.stage + 1, saved=saved)
        state, survivors = self._advance_level(state)
        info = self._info(state, survivors)
        if not len(state.pending.slots):
            state = self._continue(state)
        return state, replace(info, forecast=self._forecast(state))

    def _store(self, state: AmsState, rollouts: Rollouts) -> None:
        state.population.store(state.pending.slots, state.pending.start, rollouts)

    def estimate(self, state: AmsState) -> list[Result]:
        """Return the mean of the runs with its interval."""
        return [summarise(self.name, self.config, state)]

    def _continue(self, state: AmsState) -> AmsState:
        """Begin the runs that count after the pilot, or further ones."""
        if state.looks is None:
            return self._after_pilot(state)
        more = state.looks.missing(
            state.done, lambda: summarise(self.name, self.config, state).relative_error
        )
        return state.next_batch(min(more, self._batch(state.plan, state.particles))) if more else state

    def _after_pilot(self, state: AmsState) -> AmsState:
        result, plan = summarise(self.name, self.config, state), state.plan
        roots = result.diagnostics["roots"][0] if result.probability else 0
        pilot = Pilot(state.tally.rollouts, roots, result.relative_error**2, cost=state.tally.steps)
        # With a budget, larger runs are fewer.
        growth = pilot.wanted_growth
        while growth > 1 and not self._affords(plan, growth):
            growth -= 1
        counting = self._begin_counting(plan, replace(pilot, growth=growth))
        return replace(counting, tally=state.tally, saved=state.saved)

    def _forecast(self, state: AmsState) -> CostForecast | None:
        slope = (_STEPS_OF_RUN - 1.0) / math.log(_NOMINAL)
        if state.looks is not None:
            return forecast_cost(state, state.looks, 1, slope)
        growth = next((g for g in range(MOST_GROWTH, 1, -1) if self._affords(state.plan, g)), 1)
        most = self._most_runs(state.plan, pilots=1)
        looks = Looks.until(self.config.relative_error, self.config.runs, most)
        return forecast_cost(state, looks, growth, slope)

    def _affords(self, plan: Plan, growth: int) -> bool:
        fits = run_bytes(plan, self.config.particles * growth) <= self._room()
        return fits and self._most_runs(plan, 1, growth) >= LEAST_RUNS

    def _begin_counting(self, plan: Plan, pilot: Pilot | None = None) -> AmsState:
        growth = pilot.growth if pilot else 1
        most = self._most_runs(plan, int(pilot is not None), growth)
        first, goal = self.config.runs, self.config.relative_error
        if pilot and plan.budget is not None:
            most = max(1, int(most / self._forecast_cost_ratio(plan, pilot)))
        if pilot and goal:
            first = pilot.first_look(goal, first, most)
        looks = Looks.until(goal, first, most)
        particles = self.config.particles * growth
        runs = min(looks.runs[0], self._batch(plan, particles))
        return AmsState.begin(plan, runs, particles, growth=growth, looks=looks, pilot=pilot)

    def _forecast_cost_ratio(self, plan: Plan, pilot: Pilot) -> float:
        """Return the cost of the pilot over that of a run down to ``_NOMINAL``, at least 1."""
        assert plan.budget is not None
        if plan.budget.kind == "steps":
            nominal = _STEPS_OF_RUN * self.config.particles * plan.steps
            return max(1.0, pilot.cost / nominal)
        return max(1.0, pilot.rollouts / (_ROLLOUTS_OF_RUN * self.config.particles))

    def demand(self, plan: Plan, carry: int) -> Demand:
        """Return the memory of the runs that advance together, and of as many carries as fit beside them.

        Runs that a pilot lets grow take more, as far as it is there.
        """
        runs, particles = self.config.most, self.config.particles
        runs = min(runs if plan.budget is None else self._most_runs(plan), self._batch(plan, particles))
        tables = runs * run_bytes(plan, particles)
        carries = 2 * runs * particles * carry * (plan.steps + 1)
        return Demand(tables + max(0, min(carries, self._room() - tables)), self.config.memory, "particles")

    def _batch(self, plan: Plan, particles: int) -> int:
        """Return the number of runs that may advance together: their tables take half of the memory."""
        return max(1, self._room() // (2 * run_bytes(plan, particles)))

    def _room(self) -> int:
        return allowance(self.config.memory)

    def _most_runs(self, plan: Plan, pilots: int = 0, growth: int = 1) -> int:
        """Return the largest number of runs that the rest of the budget allows.

        Args:
            plan: The task.
            pilots: Pilots of growth 1 that it paid for.
            growth: Growth of the runs.
        """
        particles, most = self.config.particles, self.config.most
        paid = affordable_runs(
            plan,
            most,
            "splitting",
            _ROLLOUTS_OF_RUN * particles,
            _STEPS_OF_RUN * particles,
            f"{particles} particles",
        )
        if plan.budget is None:
            return most
        paid = max(1, (paid - pilots) // growth)
        return paid if self.config.relative_error is None else min(paid, most)

    def _advance_level(self, state: AmsState) -> tuple[AmsState, int]:
        population = state.population
        shape = (state.runs, state.particles)
        violated, error = population.violated.reshape(shape), population.error.reshape(shape)
        # 1. The level is the K-th lowest score.
        discard = self._discard(state)
        level = next_level(population.final.reshape(shape), violated, discard)
        # 2. A run ends at a level of failures, without a parent to branch from, or below the floor.
        eligible = ~level.discarded & ~error
        state.active[:] &= ~level.reached & eligible.any(axis=1) & (state.weight >= self.config.floor)
        if state.plan.steps == 0:  # nothing to branch from: this is Monte Carlo
            state.active[:] = False
        # The estimate is unbiased wherever the levels end: here, where the next one would exceed the budget.
        if self._exceeds_budget(state, level.discarded):
            state.active[:] = False
        # 3. Discard all at or below the level; discarded failures and errors count with the present weight.
        discarded = level.discarded & state.active[:, None]
        self._retire(state, discarded & violated)
        state.error_weight[:] += state.weight * (discarded & error).mean(axis=1)
        # 4. Multiply the weight by the share that survives (stl-ams, Eq. 12, with the true number discarded).
        self._reweight(state, discarded.sum(axis=1), level.score)
        # 5. Replace each discarded particle by a branch of a survivor.
        survivors = int((~level.discarded)[state.active].sum())
        return replace(state, pending=self._branch(state, discarded, eligible, level.score)), survivors

    def _exceeds_budget(self, state: AmsState, discarded: Bools) -> bool:
        """Return whether replacing the discarded particles would exceed the runs' share of the budget."""
        plan, tally = state.plan, state.tally
        if plan.budget is None or plan.budget.kind == "seconds":
            return False
        share = _PILOT_SHARE if state.looks is None else min(1.0, state.done / state.looks.runs[-1])
        spent = tally.steps if plan.budget.kind == "steps" else tally.rollouts
        branches = int(discarded[state.active].sum()) if plan.budget.kind == "rollouts" else 0
        return spent + branches > share * plan.budget.amount

    def _discard(self, state: AmsState) -> int:
        return self.config.discard * state.growth

    def _retire(self, state: AmsState, failures: Bools) -> None:
        state.retired[:] += state.weight * failures.mean(axis=1)
        room = state.plan.kept_failures - sum(len(tapes.run) for tapes in state.discarded_failures)
        slots = np.flatnonzero(failures)[:room]
        if len(slots):
            tapes = state.population.addresses(slots, state.particles, state.first_run)
            state.discarded_failures.append(tapes)

    def _reweight(self, state: AmsState, discarded: Integers, level: Floats) -> None:
        particles = state.particles
        alive = particles - discarded
        state.weight[:] *= alive / particles
        shrink = 1.0 + 2.0 * discarded / alive + discarded * (discarded - 1.0) / alive**2
        state.pairs[:] /= np.where(discarded > 0, shrink, 1.0)
        for r in np.flatnonzero(state.active):
            state.levels[r].append((float(level[r]), int(discarded[r])))

    def _branch(self, state: AmsState, discarded: Bools, eligible: Bools, level: Floats) -> Branches:
        children = np.flatnonzero(discarded)
        run, number = np.divmod(children, state.particles)
        stage = np.full(len(children), state.stage)
        parents = choose_parents(
            eligible, run, state.plan.noise.choices(run + state.first_run, stage, number)
        )
        start = first_above(state.population.scores[parents], level[run])
        order = np.argsort(start, kind="stable")
        branches = Branches(children[order], parents[order], start[order])
        state.population.inherit(
            branches.slots, branches.parents, branches.start, stage, number[order], state.every
        )
        return branches

    def _info(self, state: AmsState, survivors: int) -> Info:
        latest = [entries[-1][0] for entries, on in zip(state.levels, state.active, strict=True) if on]
        return replace(
            state.tally,
            stage=state.stage,
            level=float(np.median(latest)) if latest else None,
            probability=float(state.probabilities.mean()),
            survivors=survivors if latest else None,
            particles=int(state.active.sum()) * state.particles if latest else None,
        )

    def _bytes_per_slot(self, state: AmsState) -> int:
        # Carries are there twice: as they come in, and in the history.
        tables = state.runs * run_bytes(state.plan, state.particles)
        return max(1, (self._room() - tables) // (2 * len(state.pending.slots)))
