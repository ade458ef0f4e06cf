"""Parameters that make a linear system fail less: gradient descent on log p (stl-ess, section V-A).

Each iteration estimates p by nested levels with exact slices, takes more failing tapes from chains at the
last level, and steps against the gradient of log p. That is Eq. 37 with its normalisation by p; its step size
hardly depends on how rare failures are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.errors import UsageError, did_you_mean
from avrare.estimation.loop import Settings, run
from avrare.estimation.result import Result
from avrare.execute.serial import SerialExecutor
from avrare.logic.api import Formula
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare_estimators.chains import rotated
from avrare_estimators.nested import EssState
from avrare_linear.ellipse import Slicer, draw
from avrare_linear.estimator import LinearLevels
from avrare_linear.estimator_config import LinearEssConfig
from avrare_linear.gaussian import TrajectoryGaussian
from avrare_linear.gradient import chain, log_gradient, sensitivity
from avrare_linear.predicates import AffineFormula
from avrare_linear.system import LinearSystem

PARAMETERS = ("mean", "spread", "process", "measurement", "reference", "feedforward", "gain", "observer")
"""What can be synthesised: attributes of ``LinearSystem``; three of them are factors of covariances."""


@dataclass(frozen=True)
class Effort:
    """What an iteration spends.

    Attributes:
        chains: Of a run of nested levels.
        runs: Independent runs.
        moves: Further steps of each chain among the failures; the tapes of all of them give the gradient.

    Raises:
        UsageError: They are too few.
    """

    chains: int = 50
    runs: int = 4
    moves: int = 20

    def __post_init__(self) -> None:
        if self.chains < 2 or self.runs < 1 or self.moves < 0:
            raise UsageError("synthesis needs at least 2 chains, 1 run, and no negative number of moves")


@dataclass(frozen=True)
class Step:
    """An iteration.

    Attributes:
        parameter: Where it was, in the parameter's own shape.
        probability: Of failure there.
        gradient: Of log p, in the same shape.
    """

    parameter: Floats
    probability: float
    gradient: Floats


@dataclass(frozen=True)
class Failing:
    """A weighted sample of the noise's law given failure.

    Attributes:
        probability: Of failure.
        tape: (F, T + 1, noise_size).
        weight: (F,) that add up to 1.
    """

    probability: float
    tape: Floats
    weight: Floats


class _Keeping(LinearLevels):
    """Nested levels that keep their last samples."""

    def estimate(self, state: EssState) -> list[Result]:
        """The result; the samples stay behind."""
        self.last = state
        return super().estimate(state)


def failing_tapes(problem: Problem, effort: Effort, seed: int = 0) -> Failing:
    """The failure probability and tapes that fail; a run's tapes weigh as much as its estimate.

    Raises:
        UsageError: The problem is not affine, or no failure was found.
    """
    formula = problem.monitors[0].formula  # type: ignore[attr-defined]
    levels = _Keeping(LinearEssConfig(chains=effort.chains, runs=effort.runs))
    (result,) = run(problem, levels, SerialExecutor(), Settings(seed))
    descent, share = levels.last.descent, result.run_probabilities
    if descent.population is None or not share.any():
        raise UsageError("no failure was found", "raise chains or runs")
    rows = np.flatnonzero(descent.population.violated)
    owner = rows // descent.shape.samples
    weight = (share / np.maximum(np.bincount(owner, minlength=effort.runs), 1))[owner]
    slicer, noise = Slicer.of(problem.system, problem.steps, formula), NoiseSource(seed, problem.noise_size)
    tapes = list(_walk(slicer, descent.population.tape[rows], noise, effort.moves))
    weights = np.tile(weight, len(tapes))
    return Failing(result.probability, np.concatenate(tapes), weights / weights.sum())


def _walk(slicer: Slicer, tape: Floats, noise: NoiseSource, moves: int) -> Iterator[Floats]:
    """The tapes, and where chains from them come to among the failures."""
    yield tape
    chains, steps, along = np.arange(len(tape)), np.arange(tape.shape[1]), slicer.margins(tape)
    for move in range(moves):
        stage = 2**32 - 1 - move  # far from the estimate's own
        other = noise.normals(0, stage, chains[:, None], steps)
        across = slicer.margins(other)
        angle = draw(slicer.cut(along, across), noise.choices(0, stage, chains))
        tape, along = rotated(tape, other, angle), rotated(along, across, angle)
        yield tape


def parameter_gradient(
    system: LinearSystem, formula: Formula, steps: int, parameter: str, effort: Effort, seed: int = 0
) -> Step:
    """The failure probability of a system and the gradient of its logarithm in one of ``PARAMETERS``.

    Raises:
        UsageError: There is no such parameter, or there is no gradient in it.
    """
    if parameter not in PARAMETERS or getattr(system, parameter) is None:
        raise UsageError(f"there is no parameter {parameter!r}", did_you_mean(parameter, PARAMETERS))
    value: Floats = getattr(system, parameter)
    failing = failing_tapes(Problem(system, formula, steps), effort, seed)
    names = AffineFormula.of(formula).signals
    gaussian = TrajectoryGaussian.of(system, steps, names)

    def build(entries: Any) -> LinearSystem:
        return _changed(system, parameter, entries.reshape(value.shape))

    moves = sensitivity(build, value.ravel(), steps, names)
    gradient = chain(gaussian, log_gradient(gaussian, failing.tape, failing.weight), moves)
    return Step(value, failing.probability, gradient.reshape(value.shape))


def _changed(system: LinearSystem, parameter: str, value: Any) -> LinearSystem:
    changes: dict[str, Any] = {parameter: value}
    return replace(system, **changes)


def descend(
    evaluate: Callable[[Floats, int], Step], start: Floats, *, rate: float | None, iterations: int,
    target: float = 0.0, tolerance: float = 0.0, least: float = 0.0,
    told: Callable[[Step], object] | None = None,
) -> list[Step]:  # fmt: skip
    """Steps of size ``rate`` against the gradient of log p.

    Stops at the first iteration whose probability is at most ``target``, or whose step is not worth
    ``least`` or would move no entry by more than ``tolerance``; the last step's parameter is the result.

    Args:
        evaluate: The step of a parameter and the number of the iteration.
        start: First parameter.
        rate: Of the steps, in the parameter's units squared; None: the one at which the first step would
            lower log p by 1 if p fell on as it begins to.
        iterations: At most.
        target: Probability that is good enough.
        tolerance: In the parameter's units.
        least: Fall of log p, to first order, that is worth a step; the gradient is a sample's, and this is
            what tells it from noise.
        told: Called with each step.

    Raises:
        UsageError: The rate is not positive and finite, or there is no iteration.
    """
    if (rate is not None and not 0.0 < rate < math.inf) or iterations < 1:
        raise UsageError("gradient descent needs a positive, finite rate and at least one iteration")
    done: list[Step] = []
    value = start
    for iteration in range(iterations):
        done.append(evaluate(value, iteration))
        if told is not None:
            told(done[-1])
        slope = float((done[-1].gradient ** 2).sum())
        rate = 1.0 / max(slope, 1e-300) if rate is None else rate
        move = rate * done[-1].gradient
        still = np.abs(move).max(initial=0.0) <= tolerance or rate * slope < least
        if done[-1].probability <= target or still:
            break
        value = value - move
    return done


def synthesise(
    system: LinearSystem, formula: Formula, steps: int, parameter: str, *, rate: float | None,
    iterations: int, target: float = 0.0, tolerance: float = 0.0, least: float = 0.0,
    effort: Effort | None = None, seed: int = 0, told: Callable[[Step], object] | None = None,
) -> list[Step]:  # fmt: skip
    """Lower a linear system's failure probability by gradient descent in one of ``PARAMETERS``.

    Args:
        system: Where to begin.
        formula: What must hold; its predicates are affine in the system's signals.
        steps: T.
        parameter: Attribute of the system that may change.
        rate: See ``descend``.
        iterations: See ``descend``.
        target: See ``descend``.
        tolerance: See ``descend``.
        least: See ``descend``.
        effort: Of an iteration.
        seed: Iteration i uses ``seed + i``.
        told: See ``descend``.

    Raises:
        UsageError: See ``parameter_gradient`` and ``descend``.
    """

    def evaluate(value: Floats, iteration: int) -> Step:
        moved = _changed(system, parameter, value)
        return parameter_gradient(moved, formula, steps, parameter, effort or Effort(), seed + iteration)

    start: Floats = getattr(system, parameter)
    return descend(
        evaluate, start, rate=rate, iterations=iterations, target=target, tolerance=tolerance, least=least,
        told=told,
    )  # fmt: skip
