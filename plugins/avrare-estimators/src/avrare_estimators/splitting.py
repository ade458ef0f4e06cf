"""Adaptive multilevel splitting over online monitors (stl-ams, section III-B)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from avrare.errors import UsageError
from avrare.estimation.plan import Info, Plan
from avrare.estimation.result import Result
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers, Request, Rollouts, total_counts
from avrare_estimators.config import AmsConfig
from avrare_estimators.levels import choose_parents, first_above, next_level
from avrare_estimators.population import Population
from avrare_estimators.summary import summarise


def build(config: AmsConfig, scene: object | None = None) -> Splitting:
    """The estimator of a scenario or a call."""
    return Splitting(config)


@dataclass(frozen=True)
class Tally:
    """What all stages add up to."""

    rollouts: int = 0
    steps: int = 0
    failures: int = 0
    errors: int = 0
    counts: tuple[tuple[str, int], ...] = ()
    messages: tuple[str, ...] = ()

    def plus(self, outcome: Rollouts) -> Tally:
        """With one more stage."""
        counts = dict(self.counts)
        for name, value in total_counts([outcome]).items():
            counts[name] = counts.get(name, 0) + value
        return Tally(
            self.rollouts + len(outcome.error),
            self.steps + outcome.simulated_steps,
            self.failures + int(outcome.violated.sum()),
            self.errors + int(outcome.error.sum()),
            tuple(sorted(counts.items())),
            (*self.messages, *outcome.messages)[:5],
        )


@dataclass(frozen=True)
class AmsState:
    """State of R runs; the population and the per-run arrays are written in place.

    Attributes:
        plan: The task.
        runs: R.
        population: R x N slots.
        weight: (R,) product of the surviving shares.
        pairs: (R,) factor of the genealogical variance estimate (docs/statistics.md).
        active: (R,) the run has not ended.
        stage: Stages asked for.
        pending: Slots and branch steps of the rollouts in hand.
        levels: Level and number discarded of each stage, per run.
        first: Robustness of the first stage's rollouts.
        tally: Costs so far.
    """

    plan: Plan
    runs: int
    population: Population
    weight: Floats
    pairs: Floats
    active: Bools
    stage: int
    pending: tuple[Integers, Integers]
    levels: tuple[list[tuple[float, int]], ...]
    first: Floats
    tally: Tally


class Splitting:
    """The estimator: R runs of N particles as one batch."""

    name = "ams"
    single = True

    def __init__(self, config: AmsConfig) -> None:
        self.config = config

    def init(self, plan: Plan) -> AmsState:
        """State before the first rollout."""
        particles = self.config.particles
        runs = self._runs(plan)
        slots = np.arange(runs * particles)
        return AmsState(
            plan, runs, Population.empty(len(slots), particles, plan.steps),
            weight=np.ones(runs), pairs=np.full(runs, 1.0 / (particles * (particles - 1))),
            active=np.ones(runs, dtype=bool), stage=0, pending=(slots, np.full(len(slots), -1)),
            levels=tuple([] for _ in range(runs)), first=np.zeros(0), tally=Tally(),
        )  # fmt: skip

    def ask(self, state: AmsState) -> Request | None:
        """The first N of every run, then the successors of the discarded."""
        slots, start = state.pending
        if not len(slots):
            return None
        run, particle = np.divmod(slots, self.config.particles)
        carried = start >= 0
        carries = state.population.branch(slots[carried], start[carried]) if state.stage else ()
        stage = np.full(len(slots), state.stage)
        return Request(run, stage, particle, start, carries, keep_carries=True)

    def tell(self, state: AmsState, rollouts: Rollouts) -> tuple[AmsState, Info]:
        """Store the rollouts, set the next levels, discard, and choose where to branch."""
        state.population.store(*state.pending, rollouts)
        if state.stage == 0:
            state = replace(state, first=np.where(rollouts.error, np.nan, rollouts.robustness[:, 0]))
        state = replace(state, tally=state.tally.plus(rollouts), stage=state.stage + 1)
        state, survivors = self._split(state)
        return state, self._info(state, survivors)

    def estimate(self, state: AmsState) -> list[Result]:
        """The mean of the runs and its interval."""
        return [summarise(self.name, self.config, state)]

    def _split(self, state: AmsState) -> tuple[AmsState, int]:
        population, particles = state.population, self.config.particles
        shape = (state.runs, particles)
        level = next_level(
            population.final.reshape(shape), population.violated.reshape(shape), self.config.discard
        )
        eligible = ~level.discarded & ~population.error.reshape(shape)
        state.active[:] &= ~level.reached & eligible.any(axis=1) & (state.weight >= self.config.floor)
        discarded = level.discarded & state.active[:, None]
        self._weigh(state, discarded.sum(axis=1), level.score)
        children = np.flatnonzero(discarded)
        run, own = np.divmod(children, particles)
        stage = np.full(len(children), state.stage)
        parents = choose_parents(eligible, run, state.plan.noise.choices(run, stage, own))
        start = first_above(population.scores[parents], level.score[run])
        order = np.argsort(start, kind="stable")
        children, parents, start = children[order], parents[order], start[order]
        population.inherit(children, parents, start, stage, own[order])
        self._copy(population, children, parents, start)
        survivors = int((~level.discarded)[state.active].sum())
        return replace(state, pending=(children, start)), survivors

    def _copy(self, population: Population, children: Integers, parents: Integers, start: Integers) -> None:
        """The branch state becomes the child's own: its parent may be replaced before it branches again."""
        for t, carry in population.branch(parents, start):
            population.remember(t, children[start == t], carry)

    def _weigh(self, state: AmsState, killed: Integers, level: Floats) -> None:
        particles = self.config.particles
        alive = particles - killed
        state.weight[:] *= alive / particles
        shrink = 1.0 + 2.0 * killed / alive + killed * (killed - 1.0) / alive**2
        state.pairs[:] /= np.where(killed > 0, shrink, 1.0)
        for r in np.flatnonzero(state.active):
            state.levels[r].append((float(level[r]), int(killed[r])))

    def _info(self, state: AmsState, survivors: int) -> Info:
        share = state.population.violated.reshape(state.runs, -1).mean(axis=1)
        latest = [entries[-1][0] for entries, on in zip(state.levels, state.active, strict=True) if on]
        tally = state.tally
        return Info(
            stage=state.stage,
            level=float(np.median(latest)) if latest else None,
            probability=float((state.weight * share).mean()),
            survivors=survivors if latest else None,
            particles=int(state.active.sum()) * self.config.particles if latest else None,
            rollouts=tally.rollouts, failures=tally.failures, errors=tally.errors, counts=dict(tally.counts),
        )  # fmt: skip

    def _runs(self, plan: Plan) -> int:
        """Runs that the budget pays for, at twice the cost of their first stage: known before the start."""
        budget = plan.budget
        if budget is None:
            return self.config.runs
        if budget.kind == "seconds":
            raise UsageError(
                "splitting cannot be stopped by the clock: a run that has started must finish",
                "give the budget as steps=N or rollouts=N",
            )
        first = self.config.particles * (plan.steps if budget.kind == "steps" else 1)
        runs = int(budget.amount // (2 * max(first, 1)))
        if runs < 1:
            raise UsageError(
                f"a budget of {budget.kind}={budget.amount:g} does not pay for one run "
                f"of {self.config.particles} particles",
                f"raise it to {2 * first} or lower the particles",
            )
        return runs
