"""Answer: what a tool says of a problem, and the black box that counts what it asked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.calibration.problems.problem import Floats, Problem

TOO_MANY = 10.0
"""A tool that asks for so many times its budget is stopped: it has no answer."""
_NORMAL_975 = 1.959963984540054
_STUDENT_975 = {4: 2.7764, 9: 2.2622, 19: 2.0930}
"""Quantiles of Student's t by degrees of freedom."""


class NoAnswerError(Exception):
    """Reason for which a tool gives no probability."""


@dataclass(frozen=True)
class Answer:
    """Answer of a tool.

    Attributes:
        probability: Estimate.
        interval: Ends of its 95 % interval; None where it states none.
        warnings: What it warns of.
    """

    probability: float
    interval: tuple[float, float] | None
    warnings: tuple[str, ...] = ()


class Counted:
    """A problem as a black box that counts evaluations.

    Attributes:
        problem: The problem.
        most: Evaluations at which the tool is stopped.
        evaluations: Rows evaluated so far; a step of a row is a share 1 / T of one.
    """

    def __init__(self, problem: Problem, budget: int) -> None:
        self.problem, self.most, self.evaluations = problem, TOO_MANY * budget, 0.0

    def robustness(self, tapes: Floats) -> Floats:
        """Return the robustness (N,) of tapes (N, d); a failure has robustness <= 0."""
        tapes = np.asarray(tapes, dtype=float)
        self._count(len(tapes))
        return self.problem.robustness(tapes)

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Return the states (N, S) after a step."""
        self._count(len(state) / self.problem.system.steps)
        stepped: Floats = self.problem.system.step(state, noise)
        return stepped

    def _count(self, rows: float) -> None:
        self.evaluations += rows
        if self.evaluations > self.most:
            raise NoAnswerError(f"it asked for more than {TOO_MANY:.0f} times the budget")


def of_deviation(probability: float, deviation: float, warnings: tuple[str, ...] = ()) -> Answer:
    """Return the answer with a log-normal interval of this coefficient of variation."""
    if not (probability > 0.0 and math.isfinite(deviation) and deviation > 0.0):
        return Answer(probability, None, warnings)
    width = _NORMAL_975 * math.sqrt(math.log1p(deviation**2))
    return Answer(probability, (probability * math.exp(-width), probability * math.exp(width)), warnings)


def of_runs(values: Sequence[float]) -> Answer:
    """Return the mean of independent runs with Student's interval, cut off at 0."""
    mean = float(np.mean(values))
    if mean == 0.0:
        return Answer(0.0, None)
    half = _STUDENT_975[len(values) - 1] * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return Answer(mean, (max(mean - half, 0.0), mean + half))
