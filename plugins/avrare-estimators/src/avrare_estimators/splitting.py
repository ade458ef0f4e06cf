"""Adaptive multilevel splitting over online monitors (stl-ams, section III-B)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from avrare.estimation.montecarlo import FAILURE_LIMIT
from avrare.estimation.plan import Info, Plan
from avrare.estimation.result import Result
from avrare.protocols import Bools, Floats
from avrare.rollout.problem import Problem
from avrare.rollout.request import FROM_START, Integers, Request, Rollouts, total_counts
from avrare_estimators.affordable import affordable_runs
from avrare_estimators.config import AmsConfig
from avrare_estimators.levels import choose_parents, first_above, next_level
from avrare_estimators.population import Population, Tapes
from avrare_estimators.summary import summarise

_STEPS_OF_FIRST_STAGE, _ROLLOUTS_OF_FIRST_STAGE = 4, 10
"""Cost of a whole run in costs of its first stage, for budgets (docs/statistics.md)."""


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
class Pending:
    """The rollouts in hand, sorted by ``start``.

    Attributes:
        slots: (M,) where they go.
        parents: (M,) slots that they branch from.
        start: (M,) step that they branch at; -1: from the beginning.
    """

    slots: Integers
    parents: Integers
    start: Integers


@dataclass(frozen=True)
class AmsState:
    """State of R runs; the population and the per-run arrays are written in place.

    Attributes:
        plan: The task.
        runs: R.
        population: R x N slots.
        weight: (R,) product of the surviving shares.
        pairs: (R,) factor of the genealogical variance estimate (docs/statistics.md).
        retired: (R,) weight of the discarded failures: a score may put them below others.
        undecided: (R,) weight of the discarded particles that had broken down.
        active: (R,) the run has not ended.
        stage: Stages done.
        pending: The rollouts asked for next.
        levels: Level and number discarded of each stage, per run.
        lost: Tapes of discarded failures, the first few.
        first: Robustness of the first stage's rollouts.
        tally: Costs so far.
        every: Steps from one carry that is kept to the next.
    """

    plan: Plan
    runs: int
    population: Population
    weight: Floats
    pairs: Floats
    retired: Floats
    undecided: Floats
    active: Bools
    stage: int
    pending: Pending
    levels: tuple[list[tuple[float, int]], ...]
    lost: list[Tapes]
    first: Floats
    tally: Tally
    every: int = 1

    @property
    def probabilities(self) -> Floats:
        """(R,) unbiased at every stage: discarded failures count too, with the weight that they had."""
        share = self.population.violated.reshape(self.runs, -1).mean(axis=1)
        return np.asarray(self.retired + self.weight * share)


class Splitting:
    """The estimator: R runs of N particles as one batch."""

    name = "ams"
    single = True
    needs = ("branches",)
    rebuilds_carries = True

    def __init__(self, config: AmsConfig) -> None:
        self.config = config

    def prepare(self, problem: Problem) -> Problem:
        """The problem, with the score of the variant."""
        return problem.rescored("prefix") if self._published else problem

    @property
    def _published(self) -> bool:
        return self.config.variant == "published"

    def init(self, plan: Plan) -> tuple[AmsState, Info]:
        """State before the first rollout, and what to show."""
        particles = self.config.particles
        runs = affordable_runs(
            plan, self.config.runs, "splitting", _ROLLOUTS_OF_FIRST_STAGE * particles,
            _STEPS_OF_FIRST_STAGE * particles, f"{particles} particles",
        )  # fmt: skip
        slots = np.arange(runs * particles)
        state = AmsState(
            plan, runs, Population.empty(len(slots), particles, plan.steps),
            weight=np.ones(runs), pairs=np.full(runs, 1.0 / (particles * (particles - 1))),
            retired=np.zeros(runs), undecided=np.zeros(runs), active=np.ones(runs, dtype=bool), stage=0,
            pending=Pending(slots, slots, np.full(len(slots), FROM_START)),
            levels=tuple([] for _ in range(runs)), lost=[], first=np.zeros(0), tally=Tally(),
        )  # fmt: skip
        return state, Info()

    def ask(self, state: AmsState) -> Request | None:
        """The first N of every run, then the successors of the discarded."""
        pending = state.pending
        if not len(pending.slots):
            return None
        run, particle = np.divmod(pending.slots, self.config.particles)
        stage = np.full(len(pending.slots), state.stage)
        request = Request(run, stage, particle, pending.start, keep_carries=True, every=state.every)
        if not state.stage:
            return replace(request, most_bytes=self._bytes_of_a_slot(state))
        branch = pending.parents, pending.start, state.every
        return replace(request, carries=state.population.branch(*branch), past=state.population.past(*branch))

    def tell(self, state: AmsState, rollouts: Rollouts) -> tuple[AmsState, Info]:
        """Store the rollouts, set the next levels, discard, and choose where to branch."""
        state.population.store(state.pending.slots, state.pending.start, rollouts)
        if self._published:  # its failures are robustness <= 0
            state.population.violated[:] = (state.population.final >= 0.0) & ~state.population.error
        if state.stage == 0:
            state = replace(
                state, every=rollouts.every, first=np.where(rollouts.error, np.nan, rollouts.robustness[:, 0])
            )
        state = replace(state, tally=state.tally.plus(rollouts), stage=state.stage + 1)
        state, survivors = self._split(state)
        return state, self._info(state, survivors)

    def estimate(self, state: AmsState) -> list[Result]:
        """The mean of the runs and its interval."""
        return [summarise(self.name, self.config, state)]

    def _split(self, state: AmsState) -> tuple[AmsState, int]:
        population = state.population
        shape = (state.runs, self.config.particles)
        violated, error = population.violated.reshape(shape), population.error.reshape(shape)
        discard = self.config.discard + self._published
        level = next_level(population.final.reshape(shape), violated, discard)
        eligible = ~level.discarded & ~error
        state.active[:] &= ~level.reached & eligible.any(axis=1) & (state.weight >= self.config.floor)
        if state.plan.steps == 0:  # nothing to branch from: this is Monte Carlo
            state.active[:] = False
        discarded = level.discarded & state.active[:, None]
        self._retire(state, discarded & violated)
        state.undecided[:] += state.weight * (discarded & error).mean(axis=1)
        self._weigh(state, discarded.sum(axis=1), level.score)
        survivors = int((~level.discarded)[state.active].sum())
        return replace(state, pending=self._branch(state, discarded, eligible, level.score)), survivors

    def _retire(self, state: AmsState, failures: Bools) -> None:
        """Discarded failures count with the weight that they have now."""
        state.retired[:] += state.weight * failures.mean(axis=1)
        room = FAILURE_LIMIT - sum(len(tapes.run) for tapes in state.lost)
        slots = np.flatnonzero(failures)[:room]
        if len(slots):
            state.lost.append(state.population.tapes(slots, self.config.particles))

    def _branch(self, state: AmsState, discarded: Bools, eligible: Bools, level: Floats) -> Pending:
        """Successors of the discarded, each with a parent of its own run and the step that it leaves it."""
        children = np.flatnonzero(discarded)
        run, own = np.divmod(children, self.config.particles)
        stage = np.full(len(children), state.stage)
        parents = choose_parents(eligible, run, state.plan.noise.choices(run, stage, own))
        start = first_above(state.population.scores[parents], level[run])
        order = np.argsort(start, kind="stable")
        pending = Pending(children[order], parents[order], start[order])
        state.population.inherit(
            pending.slots, pending.parents, pending.start, stage, own[order], state.every
        )
        return pending

    def _weigh(self, state: AmsState, killed: Integers, level: Floats) -> None:
        particles = self.config.particles
        alive = particles - killed
        state.weight[:] *= alive / particles
        shrink = 1.0 + 2.0 * killed / alive + killed * (killed - 1.0) / alive**2
        state.pairs[:] /= np.where(killed > 0, shrink, 1.0)
        for r in np.flatnonzero(state.active):
            state.levels[r].append((float(level[r]), int(killed[r])))

    def _info(self, state: AmsState, survivors: int) -> Info:
        latest = [entries[-1][0] for entries, on in zip(state.levels, state.active, strict=True) if on]
        tally = state.tally
        return Info(
            stage=state.stage,
            level=float(np.median(latest)) if latest else None,
            probability=float(state.probabilities.mean()),
            survivors=survivors if latest else None,
            particles=int(state.active.sum()) * self.config.particles if latest else None,
            rollouts=tally.rollouts, failures=tally.failures, errors=tally.errors, counts=dict(tally.counts),
        )  # fmt: skip

    def _bytes_of_a_slot(self, state: AmsState) -> int:
        """Room for the carries of one slot."""
        return max(1, int(self.config.memory * 2**20) // len(state.population.root))
