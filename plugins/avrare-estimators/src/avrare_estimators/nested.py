"""Elliptical slice sampling: the probability of failure as a product over nested levels (stl-ess).

A pilot of few chains finds the levels and tunes the kernel; a second pass with fresh samples follows what
it has found, and counts. Given the pilot, the second pass is unbiased: its levels and kernels depend on
nothing that it draws. All runs advance as one batch, each at its own levels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.estimation.plan import Info, Plan
from avrare.estimation.result import Result, Worst
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare_estimators.affordable import affordable_runs
from avrare_estimators.chains import Kernel
from avrare_estimators.descent import Descent, Shape
from avrare_estimators.ess_config import EssConfig
from avrare_estimators.ess_summary import summarise
from avrare_estimators.kernels import kernel_of
from avrare_estimators.splitting import Tally

_SECOND = 2**31
"""First stage of the second pass."""
_NOMINAL = 1e-4
"""Probability down to which a run goes, for budgets."""
_FEWEST = 5
"""Chains of a pilot."""


def build(config: EssConfig, scene: object | None = None) -> NestedLevels:
    """The estimator of a scenario or a call."""
    return NestedLevels(config)


@dataclass(frozen=True)
class EssState:
    """State of all runs.

    Attributes:
        plan: The task.
        descent: The pass in hand, or the last one.
        counting: It is the pass that counts.
        tally: Costs so far.
        first: Robustness of the first draw, NaN for errors.
        worst: The least robust rollout so far.
        pilot: Rollouts of the pilot.
    """

    plan: Plan
    descent: Descent
    counting: bool
    tally: Tally
    first: Floats
    worst: Worst
    pilot: int


class NestedLevels:
    """The estimator."""

    name = "ess"
    single = True
    needs = ("noise",)
    notes: Mapping[str, str] = {}
    """Health warnings that the system wants on every result."""

    def __init__(self, config: EssConfig) -> None:
        self.config = config
        self.kernel: Kernel = kernel_of(config)

    def prepare(self, problem: Problem) -> Problem:
        """The problem, with its weights if it has any; a kernel that must know the system is told."""
        self.notes, problem = _notes(problem), _weighing(problem)
        tell = getattr(self.kernel, "of", None)
        if tell is not None:
            self.kernel = tell(problem)
        return problem

    def init(self, plan: Plan) -> tuple[EssState, Info]:
        """State before the first rollout, and what to show."""
        rollouts, chains = self._rollouts(), f"{self.config.chains} chains"
        runs = affordable_runs(plan, self.config.runs, "nested levels", rollouts, rollouts, chains)
        counting = not self.config.second_pass
        descent = Descent.begin(plan, self._shape(runs, second=False), self.kernel, None)
        nothing = Worst(np.zeros((plan.steps + 1, plan.noise.noise_size)), math.nan)
        return EssState(plan, descent, counting, Tally(), np.zeros(0), nothing, 0), Info()

    def ask(self, state: EssState) -> Request | None:
        """The fresh tapes of a pass, then the proposals of all chains that wait."""
        proposal = state.descent.proposal
        return None if proposal is None else Request.replay(proposal)

    def tell(self, state: EssState, rollouts: Rollouts) -> tuple[EssState, Info]:
        """Let chains and levels go on; after the pilot begin the pass that counts."""
        state = replace(state, tally=state.tally.plus(rollouts), worst=_worst(state, rollouts))
        if state.tally.rollouts == len(rollouts.error):
            state = replace(state, first=np.where(rollouts.error, np.nan, rollouts.robustness[:, 0]))
        state = replace(state, descent=state.descent.tell(rollouts))
        if state.descent.proposal is None and not state.counting:
            state = self._second(state)
        return state, _info(state)

    def estimate(self, state: EssState) -> list[Result]:
        """The mean of the runs and its interval."""
        return [summarise(self.name, self.config, self.kernel, state, self.notes)]

    def _second(self, state: EssState) -> EssState:
        """The pass that counts, whatever the pilot has come to."""
        pilot = state.descent
        shape = self._shape(pilot.shape.runs, second=True)
        descent = Descent.begin(state.plan, shape, self.kernel, pilot.steps)
        return replace(state, counting=True, descent=descent, pilot=state.tally.rollouts)

    def _shape(self, runs: int, second: bool) -> Shape:
        """The size of the second pass, or of the first."""
        config, chains = self.config, self.config.chains
        if config.second_pass and not second:
            chains = min(chains, max(_FEWEST, math.ceil(config.pilot * chains)))
        samples = chains * config.length
        survivors = min(max(1, round(config.level_probability * samples)), samples - 1)
        stage = _SECOND if second else 0
        return Shape(runs, chains, config.length, config.skip, survivors, config.floor, stage)

    def _rollouts(self) -> int:
        """Of one run that goes down to 1e-4."""
        shares = math.ceil(math.log(_NOMINAL) / math.log(self.config.level_probability))
        passes = (False, True) if self.config.second_pass else (False,)
        shapes = [self._shape(1, second) for second in passes]
        moves = sum(shape.chains * (shape.length - 1) * (shape.skip + 1) for shape in shapes)
        fresh = sum(shape.samples for shape in shapes)
        return fresh + math.ceil((shares - 1) * moves * self.kernel.rollouts)


def _notes(problem: Problem) -> Mapping[str, str]:
    """What the system, or the simulator of a closed loop, has to say of every result."""
    system = problem.system
    found: Mapping[str, str] = getattr(getattr(system, "simulator", system), "notes", {})
    return found


def _weighing(problem: Problem) -> Problem:
    """The problem with its system asked for weights, where it has any."""
    ask = getattr(problem.system, "weighing", None)
    if ask is None:
        return problem
    monitors = dict(zip(problem.names, problem.monitors, strict=True))
    score: Any = problem.score
    return Problem(ask(), monitors, problem.steps, chunk=problem.chunk).rescored(score)


def _worst(state: EssState, rollouts: Rollouts) -> Worst:
    """The least robust of what was known and the ``rollouts`` of the proposals in hand."""
    robustness = np.where(rollouts.error, np.inf, rollouts.robustness[:, 0])
    row = int(np.argmin(robustness))
    known, tapes = state.worst.robustness, state.descent.proposal
    if tapes is None or rollouts.error[row] or known <= robustness[row]:
        return state.worst
    return Worst(tapes[row].copy(), float(robustness[row]))


def _info(state: EssState) -> Info:
    descent, tally = state.descent, state.tally
    levels = np.sort(descent.steps[-1].level[descent.steps[-1].going]) if descent.steps else np.zeros(0)
    return Info(
        stage=len(descent.steps),
        level=float(levels[len(levels) // 2]) if len(levels) else None,
        probability=float(descent.probabilities.mean()) if descent.population is not None else None,
        survivors=None,
        particles=int(descent.active.sum()) * descent.shape.samples if descent.active.any() else None,
        rollouts=tally.rollouts, failures=tally.failures, errors=tally.errors, counts=dict(tally.counts),
    )  # fmt: skip
