"""Shrinking: the smallest noise that still fails.

Delta debugging first removes what is not needed (``tape_reduction``). It is greedy: while more than a tenth
of the norm is left, it is repeated in other orders. The best result is then turned within its channels
towards the origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.analysis.failures.tape_evaluator import ProgressCallback, TapeEvaluator
from avrare.analysis.failures.tape_reduction import descend, order_by_norm, reduce_tape
from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem

BUDGET = 3000
"""Default number of rollouts to shrink one failure."""
_TARGET_RATIO = 0.1
"""Ratio of the norm after to the norm before at which the search stops."""
_RESTARTS = 3


@dataclass(frozen=True)
class ShrinkResult:
    """A shrunk failure.

    Attributes:
        noise: (steps + 1, noise_size) of the shrunk failure.
        before: Norm of the original noise.
        after: Norm of ``noise``.
        nonzero: Number of nonzero entries of ``noise``.
        rollouts: Rollouts used.
        reason: Why more than a tenth of the norm is left, or None if it is not.
        passing_noise: If the rollout fails without noise (``noise`` is zero): small noise (steps + 1,
            noise_size) with which it passes, or None if none was found. Otherwise None.
    """

    noise: Floats
    before: float
    after: float
    nonzero: int
    rollouts: int
    reason: str | None
    passing_noise: Floats | None = None

    @property
    def ratio(self) -> float:
        """Norm after over norm before."""
        return self.after / self.before if self.before > 0.0 else 0.0


def shrink(
    problem: Problem, tape: Floats, budget: int = BUDGET, progress: ProgressCallback | None = None
) -> ShrinkResult:
    """Make the noise of a failure as small as possible while it still fails.

    Args:
        problem: Problem whose first specification is violated.
        tape: (steps + 1, noise_size) of the failure.
        budget: Largest number of rollouts.
        progress: Called after each chunk of rollouts.

    Raises:
        UsageError: The tape does not fail.
    """
    evaluate = TapeEvaluator(problem, budget, progress)
    evaluate.activity = "shrinking"
    fails = evaluate([tape, np.zeros_like(tape)]).fails
    if not fails[:1].any():
        raise UsageError("cannot shrink: the rollout does not fail")
    if fails[1:].any():
        passing_noise = _find_passing_noise(problem, evaluate)
        return ShrinkResult(np.zeros_like(tape), _norm(tape), 0.0, 0, evaluate.rollouts, None, passing_noise)
    small = _search(evaluate, tape)
    before, after = _norm(tape), _norm(small)
    reason = _explain_rest(evaluate, before, after)
    return ShrinkResult(small, before, after, int(np.count_nonzero(small)), evaluate.rollouts, reason)


def _search(evaluate: TapeEvaluator, tape: Floats) -> Floats:
    # 1. One reduction may be enough.
    target, budget = _TARGET_RATIO * _norm(tape), evaluate.budget
    small = reduce_tape(evaluate, tape)
    # 2. Repeat it in other orders, which share the remaining budget.
    for number in range(_RESTARTS):
        if _norm(small) <= target or not evaluate.remaining:
            return small
        evaluate.budget = evaluate.rollouts + evaluate.remaining // (_RESTARTS + 1 - number)
        other = reduce_tape(evaluate, tape, order_by_norm(number))
        evaluate.budget = budget
        small = min(small, other, key=_norm)
    if _norm(small) <= target or not evaluate.remaining:
        return small
    # 3. Turn the best result within its channels.
    turned = descend(evaluate, small, channels=np.asarray(small.any(axis=0)))
    # a turned tape has more nonzero numbers; it replaces the result only below this ratio of its norm
    largest_ratio = 0.95
    return turned if _norm(turned) <= max(largest_ratio * _norm(small), target) else small


def _norm(tape: Floats) -> float:
    return float(np.linalg.norm(tape))


def _explain_rest(evaluate: TapeEvaluator, before: float, after: float) -> str | None:
    if after <= _TARGET_RATIO * before:
        return None
    smallest, smaller = evaluate.smallest_failure()
    target = f"a tenth is a norm of {_TARGET_RATIO * before:.2g}"
    reason = f"{target}; none of {smaller} tapes with a norm below {smallest:.2g} fails"
    return reason if evaluate.remaining else f"{reason}; the budget of rollouts is used up"


def _find_passing_noise(problem: Problem, evaluate: TapeEvaluator) -> Floats | None:
    passing = TapeEvaluator(problem, evaluate.remaining, evaluate.progress, seek_pass=True)
    passing.activity = "looking for noise that passes"
    noise = NoiseSource(0, problem.noise_size)
    steps = np.arange(problem.steps + 1)
    tapes = [noise.normals(0, 0, particle, steps) for particle in range(25)]
    passes = np.flatnonzero(passing(tapes).fails)
    small = reduce_tape(passing, tapes[int(passes[0])]) if len(passes) else None
    evaluate.rollouts += passing.rollouts
    return small
