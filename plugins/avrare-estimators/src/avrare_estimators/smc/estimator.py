"""Sequential Monte Carlo with learned potentials (twisted SMC), resampled at fixed times."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from avrare.base.errors import UsageError
from avrare.base.memory import allowance
from avrare.estimation.plan.memory import Demand
from avrare.estimation.plan.plan import Estimator, Info, Plan
from avrare.estimation.result.result import Result, Worst
from avrare.protocols import Floats
from avrare.rollout.child_process import run_guarded
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare.stack.features import system_features
from avrare_estimators.common.config import LEAST_PILOT
from avrare_estimators.common.learning.dictionary import dictionary_bytes
from avrare_estimators.common.learning.pooled_samples import require_noise
from avrare_estimators.common.looks import Looks
from avrare_estimators.common.samples.sampling import wave_bytes
from avrare_estimators.smc.config import SmcConfig
from avrare_estimators.smc.learning import Learning
from avrare_estimators.smc.particles import Course, Particles
from avrare_estimators.smc.summary import Counted, summarise

_LEAST_PARTICLES = 20
_SCALED_PILOT, _SCALED_STAGES = 0.25, 2
_CARRY = 4096
"""Bytes of a particle's carry where they are not known."""
_FEATURES = 32
"""Number of features where it is not known before the first rollout."""


def build(config: SmcConfig, scene: object | None = None) -> SequentialMonteCarlo:
    """Build the estimator of a scenario or a call."""
    return SequentialMonteCarlo(config)


@dataclass(frozen=True)
class SmcState:
    """State of an estimate.

    Attributes:
        plan: The task.
        learning: Learning under way or done.
        particles: Runs under way; None while learning, and at the end.
        course: Course that the counting runs share; None while learning.
        looks: Numbers of runs at which the estimate may end; None while learning.
        counted: Runs that have ended.
        tally: Cost so far.
    """

    plan: Plan
    learning: Learning
    particles: Particles | None = None
    course: Course | None = None
    looks: Looks | None = None
    counted: tuple[Counted, ...] = ()
    tally: Info = field(default_factory=Info)


class SequentialMonteCarlo(Estimator):
    """Estimator ``smc``: R runs of N particles, resampled by frozen potentials."""

    name = "smc"
    single = True
    final_scores = True
    stops_early = True
    rebuilds_carries = True
    needs = ("branches", "noise")

    def __init__(self, config: SmcConfig) -> None:
        self.config = config
        self.features = _FEATURES
        self.carry = _CARRY
        self.problem: Problem | None = None

    def prepare(self, problem: Problem) -> Problem:
        """Return the problem unchanged; its failures are replayed."""
        self.problem = problem
        self.features = _count_features(problem)
        return problem

    def init(self, plan: Plan) -> tuple[SmcState, Info]:
        """Return the state before the first rollout, and its progress."""
        require_noise(plan)
        return SmcState(plan, Learning.begin(self.config, plan, self._affordable(plan))), Info()

    def scale(self, rollouts: float, probability: float) -> SequentialMonteCarlo | None:
        """Return one run with its learning that cost about ``rollouts`` rollouts."""
        pilot = int(_SCALED_PILOT * rollouts)
        learning = pilot * (2 + _SCALED_STAGES) // 2
        if pilot < LEAST_PILOT:
            return None
        sized = SmcConfig(
            runs=1,
            particles=max(_LEAST_PARTICLES, int(rollouts) - learning),
            pilot=pilot,
            stages=_SCALED_STAGES,
            memory=self.config.memory,
        )
        return SequentialMonteCarlo(sized)

    def ask(self, state: SmcState) -> Request | None:
        """Ask for the next wave of learning, or for the next segment of all particles."""
        if state.particles is not None:
            return state.particles.request()
        return state.learning.pending if state.course is None else None

    def tell(self, state: SmcState, rollouts: Rollouts) -> tuple[SmcState, Info]:
        """Take in the rollouts and go on."""
        state = replace(state, tally=state.tally.plus(rollouts))
        if state.particles is not None:
            state = self._advance(state, state.particles, rollouts)
        else:
            state = self._learn(state, rollouts)
        return state, self._info(state)

    def estimate(self, state: SmcState) -> list[Result]:
        """Return the mean of the runs with its interval, and the robustness of complete rollouts."""
        assert state.looks is not None
        assert self.problem is not None
        result = summarise(self.name, state.plan, state.learning, state.counted, state.looks, state.tally)
        failures, worst = result.failures, result.worst
        robustness = _complete(self.problem, failures.noise, failures.robustness)
        (least,) = _complete(self.problem, worst.noise[None], np.array([worst.robustness])).tolist()
        failures = replace(failures, robustness=robustness)
        return [replace(result, failures=failures, worst=Worst(worst.noise, least))]

    def demand(self, plan: Plan, carry: int) -> Demand:
        """Return the memory of the rollouts to learn from and of the runs that advance together."""
        config, self.carry = self.config, carry or _CARRY
        rows = config.pilot * (2 + config.stages) // 2
        learning = rows * (8 * self.features * config.times + 150)
        if config.proposal == "learned":
            learning += dictionary_bytes(plan.steps)
        together = min(self._together(config.particles), config.most)
        counting = together * config.particles * (3 * self.carry + self._row)
        held = learning + max(wave_bytes(plan, config.memory), counting)
        return Demand(held, config.memory, "pilot" if learning > counting else "particles")

    @property
    def _row(self) -> int:
        particle_bytes = 250  # bytes of a particle at the peak, except for its carry
        return particle_bytes + 40 * self.config.times

    def _together(self, particles: int) -> int:
        """Return the number of runs that may advance together: they take half of the memory."""
        return max(1, allowance(self.config.memory) // (2 * particles * (3 * self.carry + self._row)))

    def _learn(self, state: SmcState, rollouts: Rollouts) -> SmcState:
        before, learning = state.learning.task, state.learning.tell(rollouts)
        tally = state.tally
        if isinstance(before, Particles):
            # Nothing is copied after the last segment, where the next task begins.
            task = learning.task
            after = task if isinstance(task, Particles) and task.segment else before
            tally = _count_copies(tally, before, after, len(rollouts.error))
        state = replace(state, learning=learning, tally=tally)
        return self._begin_counting(state) if learning.task is None else state

    def _advance(self, state: SmcState, before: Particles, rollouts: Rollouts) -> SmcState:
        particles = before.tell(rollouts)
        tally = _count_copies(state.tally, before, particles, len(rollouts.error))
        state = replace(state, tally=tally, particles=particles)
        if not particles.done:
            return state
        counted = (*state.counted, Counted.of(particles))
        return self._next_runs(replace(state, counted=counted, particles=None))

    def _next_runs(self, state: SmcState) -> SmcState:
        assert state.looks is not None
        assert state.course is not None
        done = sum(len(batch.probabilities) for batch in state.counted)
        more = state.looks.missing(done, lambda: _relative_error(state.counted))
        if not more:
            return state
        runs = min(more, self._together(state.course.particles))
        return replace(state, particles=Particles.begin(state.course, done, runs))

    def _begin_counting(self, state: SmcState) -> SmcState:
        learning, config = state.learning, self.config
        particles, most = self._size(state)
        law, schedule, potentials = learning.law, learning.schedule, learning.potentials
        # beyond all stages of learning
        course = Course(state.plan, particles, law, schedule, potentials, 2**16, learning=False)
        looks = Looks.until(config.relative_error, min(config.runs, most), most)
        return self._next_runs(replace(state, course=course, looks=looks))

    def _size(self, state: SmcState) -> tuple[int, int]:
        """Return particles of a run and the largest number of runs, as far as the budget goes."""
        config, budget = self.config, state.plan.budget
        if budget is None:
            return config.particles, config.most
        spent = state.tally.steps if budget.kind == "steps" else state.tally.rollouts
        left = int((budget.amount - spent) // _cost(state.plan))
        runs = max(1, min(config.most, left // config.particles))
        if runs >= config.runs:
            return config.particles, runs
        return max(_LEAST_PARTICLES, left // config.runs), config.runs

    def _affordable(self, plan: Plan) -> int:
        """Return the rollouts that the budget pays for, learning and runs together."""
        config, budget = self.config, plan.budget
        runs = config.most * config.particles
        if budget is None:
            return 2 * config.pilot * (2 + config.stages) + 6 * config.pilot + runs
        if budget.kind == "seconds":
            raise UsageError(
                "sequential Monte Carlo cannot be stopped by the clock: a run that has started must finish",
                "give the budget as steps=N or rollouts=N",
            )
        unit = max(plan.steps, 1) if budget.kind == "steps" else 1
        affordable = int(budget.amount // unit)
        if (affordable - affordable // 2) * unit // _cost(plan) < _LEAST_PARTICLES * config.runs:
            needed = 2 * config.runs * _LEAST_PARTICLES * _cost(plan)
            raise UsageError(
                f"a budget of {budget.kind}={budget.amount:g} does not pay for {config.runs} runs of "
                f"{_LEAST_PARTICLES} particles and for learning",
                f"raise it to {needed} or lower runs",
            )
        return affordable

    def _info(self, state: SmcState) -> Info:
        values = [runs.probabilities for runs in state.counted]
        probability = float(np.concatenate(values).mean()) if values else None
        return replace(state.tally, stage=len(state.learning.stages), probability=probability)


def _complete(problem: Problem, noise: Floats, robustness: Floats) -> Floats:
    """Return the robustness (n,) of complete rollouts; the failing ones had that of their end.

    It stays so where the rollout breaks down after its failure.
    """
    complete = run_guarded("a replay of its failures", problem.system, partial(_replay, problem, noise))
    return np.where(np.isnan(complete), robustness, complete)


def _replay(problem: Problem, noise: Floats) -> Floats:
    size = problem.chunk
    parts = [problem.robustness(noise[k : k + size]) for k in range(0, len(noise), size)]
    return np.concatenate([*parts, np.zeros(0)])


def _cost(plan: Plan) -> int:
    """Return the cost of a particle in the unit of the budget."""
    assert plan.budget is not None
    rollouts = 5  # starts and copies of a run in multiples of its particles, for budgets
    return max(plan.steps, 1) if plan.budget.kind == "steps" else rollouts


def _count_copies(tally: Info, before: Particles, after: Particles, rows: int) -> Info:
    """Return the cost after a segment: a copy is a further rollout, a particle that continues is not."""
    continued = rows if before.segment else 0
    return replace(tally, rollouts=tally.rollouts - continued + after.copies - before.copies)


def _count_features(problem: Problem) -> int:
    """Return the number of features of a state."""
    try:
        state = problem.system.initial(np.zeros((1, problem.noise_size)))
        return int(system_features(problem.system, state).shape[1]) + 3
    except Exception:  # the first rollout reports it
        return _FEATURES


def _relative_error(counted: tuple[Counted, ...]) -> float:
    values = np.concatenate([batch.probabilities for batch in counted])
    mean = float(values.mean())
    return float((values / mean).std(ddof=1)) / len(values) ** 0.5 if mean and len(values) > 1 else np.inf
