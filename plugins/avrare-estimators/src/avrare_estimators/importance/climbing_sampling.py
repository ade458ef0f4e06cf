"""Learned importance sampling that may hand over to chains short of failure.

Learning ends once another stage would save less than it costs; from the best entry level on, groups of chains
climb to failure (``climb``). Where that does not pay, all is as without.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from avrare.base.errors import UsageError
from avrare.base.memory import allowance
from avrare.base.number_format import format_probability
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import Result
from avrare_estimators.common.lessons.coverage import find_coverage_doubts
from avrare_estimators.common.lessons.stored_proposal import FILE
from avrare_estimators.common.looks import Looks
from avrare_estimators.common.samples.cross_check import CrossCheck, rollouts_to_vouch
from avrare_estimators.common.samples.groups import Groups
from avrare_estimators.common.samples.sampling import Sample, wave_rows
from avrare_estimators.common.samples.scale_annealing import ScaleAnnealing
from avrare_estimators.common.samples.stages import has_reached
from avrare_estimators.common.samples.weighted_sampler import SamplingState
from avrare_estimators.common.tapes.tape_mixture import TapeMixture
from avrare_estimators.importance.climb import ClimbBatch, ClimbPilot
from avrare_estimators.importance.entry import Entry, best_entry
from avrare_estimators.importance.learned_sampling import LearnedSampling, LearnedState
from avrare_estimators.importance.route import (
    FEWEST_CHAINS,
    LEAST_GROUPS,
    PILOT_CHAINS,
    GroupSize,
    Route,
    chain_bytes,
)

_ROLLOUTS_OF_CHAIN = 100
"""Affordable rollouts for each chain of a pilot: it takes a tenth of them at a level."""
_PILOT_SHARE = 4
"""The pilot takes at most 1 / 4 of the affordable rollouts."""
_CLIMBED = (
    "Rollouts are sampled up to a level that a share of {} of them reaches, and Markov chains climb from "
    "there to failure."
)


@dataclass(frozen=True)
class ClimbingState(LearnedState):
    """State of runs that learn, and may climb.

    Attributes:
        entries: Best entry level after each stage, until a pilot has begun.
        route: What a pilot of chains has found; None before.
        pilot_rollouts: Its rollouts.
        pilots: Rollouts of the pilots of all runs.
        size: Size of the groups; None where the final sample goes to failure by itself.
        groups: Groups that are done.
    """

    entries: tuple[Entry | None, ...] = ()
    route: Route | None = None
    pilot_rollouts: int = 0
    pilots: int = 0
    size: GroupSize | None = None
    groups: Groups = field(default_factory=Groups)

    @property
    def rows(self) -> int:
        """Rollouts of this run, but for a cross-check."""
        return super().rows + self.groups.rollouts + self.pilot_rollouts

    @property
    def climbed(self) -> tuple[float, Groups] | None:
        """Entry level and groups of a climb that counts."""
        if self.route is None or self.size is None:
            return None
        return self.route.entry.level, self.groups


class ClimbingSampling(LearnedSampling):
    """Estimator ``is`` with ``climb: true``."""

    def _begin_run(self, state: SamplingState) -> LearnedState:
        names = ("plan", "rollouts", "source", "finished", "tally", "first", "fresh")
        pilots = state.pilots if isinstance(state, ClimbingState) else 0
        fields = {name: getattr(state, name) for name in names}
        return super()._begin_run(ClimbingState(**fields, pilots=pilots))

    def _begin_final(self, state: LearnedState, mixture: TapeMixture | None) -> LearnedState:
        assert isinstance(state, ClimbingState)
        route = self.file.routes.get(state.plan.names[0]) if self.file is not None else None
        if route is None:
            return super()._begin_final(state, mixture)
        size = self._size(state, route)
        if not self._affords(state, size):
            needed = math.ceil(LEAST_GROUPS * size.cost / (1.0 - self.config.check))
            raise UsageError(
                f"{state.rollouts} rollouts do not pay for {LEAST_GROUPS} groups of {size.chains} chains",
                f"raise them to {needed}",
            )
        return self._begin_groups(replace(state, route=route), route)

    def estimate(self, state: SamplingState) -> list[Result]:
        """Return the estimate; the file of the proposal holds the route of a climb as well."""
        assert isinstance(state, ClimbingState)
        result = super().estimate(state)[0]
        told, artifacts = dict(result.diagnostics), dict(result.artifacts)
        told["learning_rollouts"] += state.pilots
        if state.route is not None and state.climbed is not None:
            text = _CLIMBED.format(format_probability(state.route.entry.probability))
            others = [note for note in result.notes if note.kind != "learning"]
            result = replace(result, notes=(*others, Note("climb", text)))
            if FILE in artifacts and len(state.finished) == 1:
                artifacts[FILE] = {**artifacts[FILE], "climb": state.route.to_dict()}
        return [replace(result, diagnostics=told, artifacts=artifacts)]

    def _size_at_look(self, state: LearnedState) -> int:
        climbed = state.finished[0].climbed
        return len(climbed[1].values) if climbed is not None else super()._size_at_look(state)

    def _share(self, state: LearnedState, rows: int) -> float:
        """Return 0 where a climb is likelier than a sample of failures: it counts no stage."""
        return 0.0 if self._untried_entry(state) is not None else super()._share(state, rows)

    def _after_stage(self, state: LearnedState) -> LearnedState:
        assert isinstance(state, ClimbingState)
        if state.route is None and not any(state.shares):
            state = replace(state, entries=(*state.entries, best_entry(state.lessons)))
            entry = self._untried_entry(state)
            ready = self._learnt(state) or self._has_learnt_enough(state)
            chains = min(PILOT_CHAINS, self._affordable(state) // _ROLLOUTS_OF_CHAIN)
            if entry is not None and ready and FEWEST_CHAINS <= chains <= self._most_chains(state):
                most = self._affordable(state) // _PILOT_SHARE
                task = ClimbPilot.begin(state.plan, state.lessons, entry, chains, state.run, most)
                return replace(state, task=task)
        return super()._after_stage(state)

    def _gives_up(self, state: LearnedState) -> bool:
        """Return whether stages gain nothing, neither over Monte Carlo nor for a climb."""
        assert isinstance(state, ClimbingState)
        gains = self._untried_entry(state) is not None and not self._has_learnt_enough(state)
        return super()._gives_up(state) and not gains

    def _untried_entry(self, state: LearnedState) -> Entry | None:
        """Return the best entry of a climb yet to be tried, if there is one short of failure.

        Where learning knows failures well, the proposal goes to them: they need not lie above any level.
        """
        assert isinstance(state, ClimbingState)
        if state.route is not None or not state.entries or has_reached(state.stages[-1]):
            return None
        entry = state.entries[-1]
        return entry if entry is not None and entry.climbs else None

    def _most_chains(self, state: LearnedState) -> int:
        """Return the chains of a group that fit into half of the memory."""
        return allowance(self.config.memory) // (2 * chain_bytes(state.plan))

    def _has_learnt_enough(self, state: ClimbingState) -> bool:
        """Return whether the last stage has saved less of the climb than the next will cost."""
        before, now = state.entries[-2:] if len(state.entries) > 1 else (None, None)
        if before is None or now is None:
            return False
        known, goal = state.lessons.guessed_probability, self.config.relative_error
        cost = now.cost(known)
        rollouts = 1.0 / goal**2 if goal is not None else self._affordable(state) / max(cost, 1e-9)
        return (before.cost(known) - cost) * rollouts < self._stage_rows(state, 1)

    def _task_complete(self, state: SamplingState) -> SamplingState:
        assert isinstance(state, ClimbingState)
        if isinstance(state.task, ClimbPilot):
            return self._after_pilot(state, state.task)
        if isinstance(state.task, ClimbBatch):
            return self._after_batch(state, state.task)
        return super()._task_complete(state)

    def _after_pilot(self, state: ClimbingState, pilot: ClimbPilot) -> LearnedState:
        # A pilot has found the levels, and what a climb costs. It pays, or learning goes on.
        route = pilot.route()
        rollouts = pilot.level_pass.shape.chains * route.moves
        state = replace(
            state, route=route, pilot_rollouts=rollouts, pilots=state.pilots + rollouts, task=None
        )
        if not pilot.pays(self.config.target_share) or not self._affords(state, self._size(state, route)):
            return super()._after_stage(state)
        return self._begin_groups(state, route)

    def _size(self, state: ClimbingState, route: Route) -> GroupSize:
        return route.sized(self.config.relative_error, self._affordable(state), self._most_chains(state))

    def _affords(self, state: ClimbingState, size: GroupSize) -> bool:
        return LEAST_GROUPS * size.cost <= self._affordable(state)

    def _begin_groups(self, state: ClimbingState, route: Route) -> LearnedState:
        goal, affordable, size = self.config.relative_error, self._affordable(state), self._size(state, route)
        looks = Looks.until(goal, size.first, max(size.first, affordable // size.cost))
        return self._begin_batch(replace(state, size=size, looks=looks), route, size)

    def _begin_batch(self, state: ClimbingState, route: Route, size: GroupSize) -> LearnedState:
        assert state.looks is not None
        done = len(state.groups.values)
        room = max(1, self._most_chains(state) // size.chains)
        groups = min(room, state.looks.missing(done, lambda: relative_error(state.groups)))
        stage = len(state.stages)
        wave = wave_rows(state.plan, self.config.memory)
        task = ClimbBatch.begin(
            state.plan, route, size, groups, done, state.run, stage, self.config.target_share, wave
        )
        return replace(state, task=task)

    def _after_batch(self, state: ClimbingState, batch: ClimbBatch) -> SamplingState:
        assert state.route is not None
        assert state.size is not None
        assert state.looks is not None
        assert batch.sample is not None
        groups, final = state.groups + batch.result(), (*state.final, batch.sample)
        stored = self._stored(replace(state, groups=groups, final=final, task=None), batch.sample)
        assert isinstance(stored, ClimbingState)
        if state.looks.missing(len(groups.values), lambda: relative_error(groups)):
            return self._begin_batch(stored, state.route, state.size)
        learning = stored.samples[: len(stored.samples) - len(final)]
        sample = Sample.join(final)
        return self._check(replace(stored, samples=(*learning, sample)), sample)

    def _cross_check(self, state: SamplingState, most: int) -> CrossCheck | ScaleAnnealing | None:
        assert isinstance(state, ClimbingState)
        if state.climbed is None:
            return super()._cross_check(state, most)
        level, groups = state.climbed
        annealing = ScaleAnnealing.begin(state.samples, self._check_rollouts(state), level)
        return annealing or CrossCheck.begin(
            state.samples, self._check_rollouts(state), most, groups.mean, level
        )

    def _rollouts_to_vouch(self, state: LearnedState) -> int:
        assert isinstance(state, ClimbingState)
        if state.climbed is None:
            return super()._rollouts_to_vouch(state)
        return rollouts_to_vouch(state.samples, state.groups.mean)

    def _climbed(self, state: SamplingState) -> tuple[float, Groups] | None:
        assert isinstance(state, ClimbingState)
        return state.climbed

    def _doubts(self, state: SamplingState) -> dict[str, str]:
        assert isinstance(state, ClimbingState)
        if state.climbed is None:
            return super()._doubts(state)
        # What the sample has to cover are the rows that enter.
        level = state.climbed[0]
        samples = tuple(one.reaching(level) for one in state.lessons.samples)
        return find_coverage_doubts(
            replace(state.lessons, samples=samples), state.samples[-1].reaching(level)
        )


def relative_error(groups: Groups) -> float:
    """Return the standard error of the groups' mean over the mean; infinite without a failure."""
    return math.sqrt(groups.variance(groups.mean)) if groups.mean else math.inf
