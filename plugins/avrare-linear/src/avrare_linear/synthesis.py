"""Synthesis of parameters by gradient descent on log p (stl-ess, Section V-A).

Each iteration estimates p by nested levels with exact slices, draws more failing tapes from chains at the
last level, and steps against the gradient of log p. This is Eq. 37 with its normalisation by p; the step size
hardly depends on how rare failures are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError, did_you_mean
from avrare.estimation.loop.loop import run
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result.result import Result
from avrare.logic.formula import Formula
from avrare.protocols import Floats
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare_estimators.common.chains.kernel import rotate
from avrare_estimators.ess.state import EssState
from avrare_linear.ellipse import Slicer, draw_angles
from avrare_linear.estimator import LinearLevels
from avrare_linear.estimator_config import LinearEssConfig
from avrare_linear.gaussian import TrajectoryGaussian
from avrare_linear.gradient import apply_chain_rule, compute_sensitivity, estimate_log_gradient
from avrare_linear.predicates import AffineFormula
from avrare_linear.system import LinearSystem

PARAMETERS = ("mean", "spread", "process", "measurement", "reference", "feedforward", "gain", "observer")
"""Attributes of ``LinearSystem`` that can be synthesised; three are factors of covariances."""


@dataclass(frozen=True)
class Effort:
    """Computing effort of an iteration.

    Attributes:
        chains: Chains of a run of nested levels.
        runs: Independent runs.
        moves: Further moves of each chain among the failures; the tapes of all moves give the gradient.

    Raises:
        UsageError: A number is too small.
    """

    chains: int = 50
    runs: int = 4
    moves: int = 20

    def __post_init__(self) -> None:
        if self.chains < 2 or self.runs < 1 or self.moves < 0:
            raise UsageError("synthesis needs at least 2 chains, 1 run, and a non-negative number of moves")


@dataclass(frozen=True)
class DescentStep:
    """Iteration of the descent.

    Attributes:
        parameter: Value of the parameter.
        probability: Failure probability at that value.
        gradient: Gradient of log p, in the shape of the parameter.
    """

    parameter: Floats
    probability: float
    gradient: Floats


@dataclass(frozen=True)
class FailureSample:
    """Weighted sample of the noise given failure.

    Attributes:
        probability: Failure probability.
        tape: (F, T + 1, noise_size) failing tapes.
        weight: (F,) weights that add up to 1.
    """

    probability: float
    tape: Floats
    weight: Floats


class _RecordingLevels(LinearLevels):
    """Nested levels that record their last state."""

    def estimate(self, state: EssState) -> list[Result]:
        """Return the result and record the state."""
        self.last = state
        return super().estimate(state)


def sample_failures(problem: Problem, effort: Effort, seed: int = 0) -> FailureSample:
    """Estimate the failure probability and sample failing tapes, each run weighted by its estimate.

    Raises:
        UsageError: The problem is not affine, or no failure was found.
    """
    # 1. Estimate p by nested levels.
    formula = problem.monitors[0].formula
    levels = _RecordingLevels(LinearEssConfig(chains=effort.chains, runs=effort.runs))
    (result,) = run(problem, levels, SerialExecutor(), Settings(seed))
    last, share = levels.last.level_pass, result.run_probabilities
    if last.population is None or not share.any():
        raise UsageError("no failure was found", "raise chains or runs")
    # 2. Weight the failing chains by the estimates of their runs.
    rows = np.flatnonzero(last.population.violated)
    owner = rows // last.shape.samples
    weight = (share / np.maximum(np.bincount(owner, minlength=effort.runs), 1))[owner]
    # 3. Continue them among the failures.
    slicer, noise = Slicer.of(problem.system, problem.steps, formula), NoiseSource(seed, problem.noise_size)
    tapes = list(_walk(slicer, last.population.tape[rows], noise, effort.moves))
    weights = np.tile(weight, len(tapes))
    return FailureSample(result.probability, np.concatenate(tapes), weights / weights.sum())


def _walk(slicer: Slicer, tape: Floats, noise: NoiseSource, moves: int) -> Iterator[Floats]:
    # The tapes, and those after each move of chains among the failures.
    yield tape
    chains, steps, along = np.arange(len(tape)), np.arange(tape.shape[1]), slicer.margins(tape)
    for move in range(moves):
        stage = 2**32 - 1 - move  # far from the stages of the estimate
        other = noise.normals(0, stage, chains[:, None], steps)
        across = slicer.margins(other)
        angle = draw_angles(slicer.cut(along, across), noise.choices(0, stage, chains))
        tape, along = rotate(tape, other, angle), rotate(along, across, angle)
        yield tape


def estimate_parameter_gradient(
    system: LinearSystem, formula: Formula, steps: int, parameter: str, effort: Effort, seed: int = 0
) -> DescentStep:
    """Estimate the failure probability and the gradient of its logarithm in one of ``PARAMETERS``.

    Raises:
        UsageError: The parameter or its gradient does not exist.
    """
    if parameter not in PARAMETERS or getattr(system, parameter) is None:
        raise UsageError(f"the system has no parameter {parameter!r}", did_you_mean(parameter, PARAMETERS))
    value: Floats = getattr(system, parameter)
    failing = sample_failures(Problem(system, formula, steps), effort, seed)
    names = AffineFormula.of(formula).signals
    gaussian = TrajectoryGaussian.of(system, steps, names)

    def build(entries: NDArray[np.complex128]) -> LinearSystem:
        return _change(system, parameter, entries.reshape(value.shape))

    derivatives = compute_sensitivity(build, value.ravel(), steps, names)
    log_gradient = estimate_log_gradient(gaussian, failing.tape, failing.weight)
    gradient = apply_chain_rule(gaussian, log_gradient, derivatives)
    return DescentStep(value, failing.probability, gradient.reshape(value.shape))


def _change(system: LinearSystem, parameter: str, value: Floats | NDArray[np.complex128]) -> LinearSystem:
    changes: dict[str, Any] = {parameter: value}
    return replace(system, **changes)


def descend(
    evaluate: Callable[[Floats, int], DescentStep],
    start: Floats,
    *,
    rate: float | None,
    iterations: int,
    target: float | None = None,
    tolerance: float = 0.0,
    least: float = 0.0,
    on_step: Callable[[DescentStep], object] | None = None,
    maximise: bool = False,
) -> list[DescentStep]:
    """Take steps of size ``rate`` against the gradient of log p, or along it (the paper's v_dir).

    Stops at the first iteration whose probability has reached ``target``, whose step gains less than
    ``least``, or would change no entry by more than ``tolerance``; the last step's parameter is the result.

    Args:
        evaluate: Function from a parameter and the number of the iteration to the step.
        start: First parameter.
        rate: Step size, in the parameter's units squared; None: the one at which the first step lowers log p
            by 1 to first order.
        iterations: Maximal number of iterations.
        target: Probability that is low (or high) enough.
        tolerance: Smallest change, in the parameter's units.
        least: Smallest gain in log p, to first order; a smaller one is lost in the noise of the estimated
            gradient.
        on_step: Function called with each step.
        maximise: Raise the probability instead: v_dir = 1, for one of success.

    Raises:
        UsageError: The rate is not positive and finite, or the iterations are none.
    """
    if (rate is not None and not 0.0 < rate < math.inf) or iterations < 1:
        raise UsageError("gradient descent needs a positive, finite rate and at least one iteration")
    descent: list[DescentStep] = []
    value = start
    for iteration in range(iterations):
        descent.append(evaluate(value, iteration))
        if on_step is not None:
            on_step(descent[-1])
        slope = float((descent[-1].gradient ** 2).sum())
        rate = 1.0 / max(slope, 1e-300) if rate is None else rate
        move = rate * descent[-1].gradient
        still = np.abs(move).max(initial=0.0) <= tolerance or rate * slope < least
        sign = 1.0 if maximise else -1.0
        if still or (target is not None and sign * (descent[-1].probability - target) >= 0.0):
            break
        value = value + sign * move
    return descent


def synthesise(
    system: LinearSystem,
    formula: Formula,
    steps: int,
    parameter: str,
    *,
    rate: float | None,
    iterations: int,
    target: float | None = None,
    tolerance: float = 0.0,
    least: float = 0.0,
    effort: Effort | None = None,
    seed: int = 0,
    on_step: Callable[[DescentStep], object] | None = None,
    maximise: bool = False,
) -> list[DescentStep]:
    """Lower a linear system's failure probability by gradient descent in one of ``PARAMETERS``.

    Args:
        system: System to start from.
        formula: Specification, with predicates that are affine in the system's signals.
        steps: T.
        parameter: Attribute of the system to change.
        rate: See ``descend``.
        iterations: See ``descend``.
        target: See ``descend``.
        tolerance: See ``descend``.
        least: See ``descend``.
        effort: Computing effort of an iteration.
        seed: Iteration i uses ``seed + i``.
        on_step: See ``descend``.
        maximise: See ``descend``.

    Raises:
        UsageError: See ``estimate_parameter_gradient`` and ``descend``.
    """

    def evaluate(value: Floats, iteration: int) -> DescentStep:
        moved = _change(system, parameter, value)
        return estimate_parameter_gradient(
            moved, formula, steps, parameter, effort or Effort(), seed + iteration
        )

    start: Floats = getattr(system, parameter)
    return descend(
        evaluate,
        start,
        rate=rate,
        iterations=iterations,
        target=target,
        tolerance=tolerance,
        least=least,
        on_step=on_step,
        maximise=maximise,
    )
