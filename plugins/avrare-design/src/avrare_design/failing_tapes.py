"""Derivatives of log p in any parameter, from failing tapes alone.

A failing tape that no longer fails after a small step forwards has crossed the border of the failures. The
tapes that begin to fail are not among the stored ones; but to first order they are as many as would stop
failing after the same step backwards. So d log p / d parameter is the difference of the shares that still
fail after both steps, over one step. The difference of the logarithms of the shares is exact where the tail
beyond the border is exponential, and is taken. It closes the gap that stl-ess leaves after Eq. 39: the
system may be a black box, and only verdicts are read. Failures that appear far from all known ones are not
seen, so a result that rests on this needs fresh tapes in the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.tape_runs import TapeRunner
from avrare.base.errors import UsageError
from avrare.rollout.problem import Problem


@dataclass(frozen=True)
class Derivative:
    """Derivative of log p along a direction.

    Attributes:
        value: The estimate.
        error: Its standard error; inf where too few failures tell.
        kept: Shares of the failures that still fail after a step backwards and forwards.
    """

    value: float
    error: float
    kept: tuple[float, float]

    @property
    def shrunk(self) -> float:
        """The estimate shrunk towards zero by its error (positive-part James and Stein)."""
        if not math.isfinite(self.error) or self.value == 0.0:
            return 0.0
        return self.value * max(0.0, 1.0 - (self.error / self.value) ** 2)


def derive_from_failures(
    problems: tuple[Problem, Problem], step: float, sample: FailureSample, runner: TapeRunner, activity: str
) -> Derivative:
    """Derive log p along a direction, at the point between two problems.

    Args:
        problems: The problem one step backwards, and one step forwards.
        step: The step.
        sample: Failures at the point itself.
        runner: Runs the failing tapes again, twice. Those that break down count as failing no more.
        activity: Label of progress displays.

    Raises:
        UsageError: The tapes of the problems have another shape.
    """
    shape = sample.failures.noise.shape[1:]
    if any((side.steps + 1, side.noise_size) != shape for side in problems):
        raise UsageError(
            f"{activity}: its values have noise tapes of different shapes",
            "choose parameters that change no noise",
        )
    tapes = sample.failures.noise
    fails = [runner(side, tapes, activity).fails.astype(np.float64) for side in problems]
    # Half a failure is added to those kept and to those lost: a share of 0 has no logarithm.
    half = 0.5 / sample.size
    back, forth = (float((sample.mean(side)[0] + half) / (1.0 + 2.0 * half)) for side in fails)
    _, error, _ = sample.mean(fails[1] / forth - fails[0] / back)
    value = (math.log(forth) - math.log(back)) / step
    return Derivative(value, max(error, 1.0 / sample.size) / step, (back, forth))
