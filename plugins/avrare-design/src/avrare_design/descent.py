"""Synthesis on any stack: numbers of a scenario, changed until its failures are rarer.

Each iteration estimates log p with the scenario's estimator, derives it from the failing tapes of that
estimate (``failing_tapes``), and steps against the gradient, each number in the unit of its own size. A step
after which p is not lower is taken back, and the next one is half as long. The estimates of the descent
choose, so they prove nothing: ``prove`` compares start and result on noise of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.tape_runs import TapeRunner
from avrare.base.errors import ScenarioError, UsageError
from avrare.estimation.result.result import Result
from avrare.protocols import Floats
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare_design.failing_tapes import Derivative, derive_from_failures
from avrare_design.scenario_numbers import ScenarioNumbers

_LONGEST = 0.5
"""Largest change of a number in one iteration, in its unit."""
_GROWTH, _MOST_FALL = 1.5, 3.0


@dataclass(frozen=True)
class Search:
    """Settings of a descent.

    Attributes:
        specification: Name of the specification.
        iterations: Estimates at most, that of the start included.
        step: Step of the differences, in units of the numbers.
        directions: Random directions of each gradient; 0: each number separately.
        target: Probability that is low enough.
        maximise: Raise the probability instead.
        seed: Seed of the first estimate; iteration i has ``seed + i``.

    Raises:
        UsageError: A number is out of range.
    """

    specification: str
    iterations: int = 5
    step: float = 0.1
    directions: int = 0
    target: float | None = None
    maximise: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if self.iterations < 1 or not 0.0 < self.step <= _LONGEST or self.directions < 0:
            needs = f"at least one iteration, a step in (0, {_LONGEST}], and no negative directions"
            raise UsageError(f"synthesis needs {needs}")
        if self.target is not None and not 0.0 < self.target < 1.0:
            raise UsageError(f"the target should be a probability between 0 and 1, not {self.target:g}")

    @property
    def sign(self) -> float:
        """-1: downhill, the paper's v_dir."""
        return 1.0 if self.maximise else -1.0

    def is_reached(self, probability: float) -> bool:
        """Return whether a probability is at the target."""
        return self.target is not None and self.sign * (probability - self.target) >= 0.0


@dataclass(frozen=True)
class Iteration:
    """Iteration of a descent.

    Attributes:
        values: (P,) numbers.
        measured: Estimate at them, with failing tapes; None where the scenario does not accept them.
        best: Nothing before was better.
        gradient: (P,) of log p in the units of the numbers, shrunk by its error; None where it was not
            wanted.
        derivatives: Along each direction.
        refusal: Why the scenario does not accept the values, or those of a difference around them.
    """

    values: Floats
    measured: Result | None
    best: bool
    gradient: Floats | None = None
    derivatives: tuple[Derivative, ...] = ()
    refusal: str = ""

    @property
    def estimate(self) -> Result:
        """``measured``, which the start and whatever is best have."""
        assert self.measured is not None
        return self.measured

    @property
    def slope(self) -> float:
        """Length of the gradient."""
        return 0.0 if self.gradient is None else float(np.linalg.norm(self.gradient))


Measure = Callable[[LoadedScenario, int], Result]
"""Estimate of a scenario's probability; the number is that of the iteration."""


def descend(
    numbers: ScenarioNumbers, search: Search, measure: Measure, runner: TapeRunner
) -> Iterator[Iteration]:
    """Yield the iterations of a descent; the last one that is ``best`` has the result.

    Args:
        numbers: Entries that may change.
        search: Settings.
        measure: Estimates p, with failures.
        runner: Runs failing tapes again.

    Raises:
        UsageError: The start has no failure to learn from.
    """
    values, best, fall = numbers.start, None, 1.0
    for i in range(search.iterations):
        result, refusal = _measure(numbers, values, measure, i)
        better = result is not None and (best is None or _beats(result, best.measured, search))
        now = Iteration(values, result, better, refusal=refusal)
        enough = (
            result is None or not len(result.failures.robustness) or search.is_reached(result.probability)
        )
        if better and result is not None and i + 1 < search.iterations and not enough:
            now = _try_gradient(now, numbers, search, runner, i)
        yield now
        if result is not None and not i and not len(result.failures.robustness):
            hint = "give a larger budget, or a run"
            raise UsageError(f"{search.specification}: no failure was found at the start", hint)
        if better:
            best, fall = now, fall if best is None else min(_GROWTH * fall, _MOST_FALL)
        else:
            fall /= 2.0
        if best is None or best.gradient is None or best.slope == 0.0:
            return
        fall = min(fall, _longest_fall(best.gradient))
        move = search.sign * fall / best.slope**2 * best.gradient  # changes log p by ``fall``, to first order
        values = best.values + numbers.scale * move


def _beats(result: Result, best: Result | None, search: Search) -> bool:
    return best is None or search.sign * (result.probability - best.probability) > 0.0


def _measure(
    numbers: ScenarioNumbers, values: Floats, measure: Measure, number: int
) -> tuple[Result | None, str]:
    try:
        return measure(numbers.at(values), number), ""
    except (ScenarioError, UsageError) as error:
        if number == 0:
            raise
        return None, str(error)  # the step left what the scenario accepts; the next one is shorter


def _try_gradient(
    now: Iteration, numbers: ScenarioNumbers, search: Search, runner: TapeRunner, number: int
) -> Iteration:
    try:
        return _with_gradient(now, numbers, search, runner, number)
    except (ScenarioError, UsageError) as error:
        if number == 0:
            raise
        return replace(now, refusal=str(error))  # nothing leads on from here


def _longest_fall(gradient: Floats) -> float:
    return _LONGEST * float(gradient @ gradient) / float(np.abs(gradient).max())


def _with_gradient(
    now: Iteration, numbers: ScenarioNumbers, search: Search, runner: TapeRunner, number: int
) -> Iteration:
    sample = FailureSample.of(now.estimate)
    lines = _directions(len(now.values), search, number)
    derivatives = []
    for k, line in enumerate(lines):
        ends = tuple(
            numbers.at(now.values + end * search.step * numbers.scale * line).problem(search.specification)
            for end in (-1.0, 1.0)
        )
        name = numbers.names[k] if not search.directions else f"direction {k + 1} of {len(lines)}"
        derivatives.append(derive_from_failures((ends[0], ends[1]), search.step, sample, runner, name))
    gradient = np.linalg.pinv(lines) @ np.array([derivative.shrunk for derivative in derivatives])
    return replace(now, gradient=gradient, derivatives=tuple(derivatives))


def _directions(size: int, search: Search, number: int) -> Floats:
    """Return directions (K, P) orthogonal to each other; a random one moves each number by about 1."""
    if not search.directions:
        return np.eye(size)
    rng = np.random.default_rng((search.seed, number))
    basis, _ = np.linalg.qr(rng.normal(size=(size, min(search.directions, size))))
    return np.asarray(math.sqrt(size) * basis.T)
