"""Sensitivity: by how much log p changes with a parameter of the stack.

Parameters of a perception error model that knows its density ratios are derived by the score function from
failing tapes alone. All others are compared on the same tapes at two values around their own: the central
difference quotient of log p, unbiased for itself except for the logarithm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from avrare.analysis.causes.failure_sample import FailureSample, normal_interval
from avrare.analysis.causes.tape_runs import TapeRunner, Verdicts, draw_tapes
from avrare.base.errors import AvrareError, ExitCode, UsageError
from avrare.base.number_format import format_interval, format_probability
from avrare.base.records import Answer, Records
from avrare.estimation.result.intervals import Interval, clopper_pearson
from avrare.estimation.result.result import Failures
from avrare.protocols import Floats, PerceptionErrorModel
from avrare.rollout.problem import Problem
from avrare.rollout.weighted_problem import find_ratio_model, log_ratios

Built = TypeVar("Built")

_BLOCK = 1000


@dataclass(frozen=True)
class Sensitivity:
    """Derivative of log p in one parameter.

    Attributes:
        parameter: Dotted path in the scenario.
        value: Its value.
        derivative: d log p / d parameter; NaN where too few rollouts fail.
        interval: Its interval.
        method: "score" (from failing tapes) or "paired" (two values on the same tapes).
        failures: Failing tapes that it rests on.
        span: Values between which "paired" compares; (value, value) for "score".
        refused: Values that the scenario does not permit, so that the span ends nearer.
        most: Upper end of p at the likelier of two values, where too few rollouts fail.
    """

    parameter: str
    value: float
    derivative: float
    interval: Interval
    method: str
    failures: int
    span: tuple[float, float]
    refused: tuple[float, ...] = ()
    most: float = math.nan

    @property
    def elasticity(self) -> float:
        """Relative change of p for one of the parameter."""
        return self.value * self.derivative

    def line(self) -> str:
        """Describe it: ``perception.sd = 1: +10 % changes p by +3.0 % (-1.0 .. +8.0), by score``."""
        if math.isnan(self.derivative):
            most = f", p at most {format_probability(self.most, 2)} at both values"
            unknown = f"not known{'' if math.isnan(self.most) else most}"
            return f"{self.parameter} = {self.value:g}: {unknown}, {self._way}"
        change, low, high = (
            100.0 * math.expm1(max(min(0.1 * abs(self.value) * end, 50.0), -50.0))
            for end in (self.derivative, *self.interval)
        )
        percents = [f"{end:+,.{1 if abs(end) < 10.0 else 0}f}" for end in (change, low, high)]
        effect = f"+10 % changes p by {percents[0]} % ({percents[1]} .. {percents[2]})"
        return f"{self.parameter} = {self.value:g}: {effect}, {self._way}"

    @property
    def _way(self) -> str:
        if not self.refused:
            return f"by {self.method}"
        refused = " and ".join(f"{number:.4g}" for number in self.refused)
        verb = "is" if len(self.refused) == 1 else "are"
        span = f"from {self.span[0]:.4g} to {self.span[1]:.4g}"
        return f"by {self.method} {span} ({refused} {verb} not permitted)"


@dataclass(frozen=True, repr=False)
class Sensitivities(Answer):
    """Sensitivities of one specification's probability.

    Attributes:
        specification: Its name.
        probability: The estimate.
        interval: Its interval.
        rows: One for each parameter, the largest effect first.
        rollouts: Rollouts that they took.
        errors: Those that broke down.
    """

    specification: str
    probability: float
    interval: Interval
    rows: tuple[Sensitivity, ...]
    rollouts: int
    errors: int

    def table(self) -> Records:
        """Return one row for each parameter."""
        return Records(
            {
                "parameter": row.parameter,
                "value": row.value,
                "derivative": row.derivative,
                "low": row.interval[0],
                "high": row.interval[1],
                "elasticity": row.elasticity,
                "method": row.method,
                "failures": row.failures,
                "from": row.span[0],
                "to": row.span[1],
            }
            for row in self.rows
        )

    def lines(self) -> list[str]:
        """Return the table as text."""
        total = f"{format_probability(self.probability)} ({format_interval(self.interval)})"
        broken = f", {self.errors} broke down" if self.errors else ""
        head = f"{self.specification}: {total}, {self.rollouts:,} rollouts{broken}"
        return [head, *(f"  {row.line()}" for row in self.rows), *self._hints()]

    def _hints(self) -> list[str]:
        if not any(math.isnan(row.derivative) for row in self.rows):
            return []
        # 50 failures mostly show a change.
        needed = f"some {50 / self.probability:,.0f} rollouts tell" if self.probability else "give more"
        return [f"  hint: {needed}, or avrare compare --estimators auto with one value against another"]


def sample_failures(
    problem: Problem, rollouts: int, seed: int, confidence: float, runner: TapeRunner
) -> FailureSample:
    """Run fresh tapes and return all that fail; UsageError if none does."""
    failing, errors = [], runner.errors
    for first in range(0, rollouts, _BLOCK):
        tapes = draw_tapes(problem, seed, 0, min(_BLOCK, rollouts - first), first)
        failing.append(tapes[runner(problem, tapes, "fresh tapes").fails])
    noise = np.concatenate(failing)
    if not len(noise):
        raise UsageError(
            f"{problem.names[0]}: none of {rollouts} rollouts failed",
            "give more of them, or the run of an estimator for rare events",
        )
    p = len(noise) / rollouts
    error = math.sqrt((1.0 - p) / (p * rollouts))
    failures = Failures(noise, np.zeros(len(noise)), len(noise))
    return FailureSample(failures, p, error, rollouts, 1, runner.errors - errors, confidence)


def knows_score(problem: Problem) -> bool:
    """Return whether the perception error model of a problem has density ratios."""
    return find_ratio_model(problem) is not None


def derive_by_score(
    problem: Problem,
    sample: FailureSample,
    parameter: str,
    value: float,
    build: Callable[[float], PerceptionErrorModel],
    runner: TapeRunner | None = None,
) -> Sensitivity:
    """Derive log p by the score function, from failing tapes.

    With the density f of the observations, d log p / d parameter is the mean over failures
    of d log f / d parameter, summed over the observations (stl-ess, Eq. 33, corrected). The terms after the
    verdict is final have mean zero and are left out. The derivative of log f is a central difference without
    noise. It is NaN where the model has none: beside the value something is observed that cannot be there.

    Args:
        problem: Problem with a closed loop.
        sample: Its failures.
        parameter: Name of the parameter, of the perception error model.
        value: Its value, not 0.
        build: Function from a value to the perception error model.
        runner: Keeps the scores of the failures.

    Raises:
        UsageError: The value is 0, or ``build`` refuses the values on both sides.
    """
    if value == 0.0:
        text = f"{parameter} is 0: the density ratio of a nearby value is unknown"
        raise UsageError(text, "give it another value, or leave it out")
    relative_step = 1e-3  # relative step of the differences of log densities, which have no noise
    step, tapes = relative_step * abs(value), sample.failures.noise

    def score() -> Floats:
        (first, up), (second, down) = (_build_near(build, value, end) for end in (step, -step))
        if not up + down:
            raise UsageError(f"{parameter} = {value:g}: no value beside it is permitted", "leave it out")
        ratios = log_ratios(problem, [first, second], tapes)
        return np.asarray((ratios[:, 0] - ratios[:, 1]) / ((up + down) * step))

    derivative, interval = sample.mean_interval((runner or TapeRunner()).keep(tapes, score))
    return Sensitivity(parameter, value, derivative, interval, "score", sample.size, (value, value))


def _build_near(build: Callable[[float], Built], value: float, step: float) -> tuple[Built, float]:
    # The share of the step is 0 at the end of the value's range: the difference is then one-sided.
    try:
        return build(value + step), 1.0
    except AvrareError as error:
        if error.exit_code is not ExitCode.USAGE:
            raise
        return build(value), 0.0


def derive_by_pairs(
    problems: tuple[Problem, Problem],
    span: tuple[float, float],
    parameter: str,
    value: float,
    *,
    rollouts: int,
    seed: int,
    confidence: float,
    runner: TapeRunner,
) -> Sensitivity:
    """Compare log p at two values of a parameter on the same fresh tapes.

    The variance of the log ratio of paired proportions is (b + c) / ((a + b)(a + c)), with a failures under
    both and b, c under one of them (Nam and Blackwelder, Statistics in Medicine 21, 2002). Tapes that break
    down at a value are left out, but each end of the interval counts them against itself.
    """
    shapes = {(problem.steps, problem.noise_size) for problem in problems}
    if len(shapes) > 1:
        text = f"{parameter}: the tapes of its two values have different shapes"
        raise UsageError(text, "choose a parameter that changes no noise")
    outcomes: list[list[Verdicts]] = [[], []]
    for first in range(0, rollouts, _BLOCK):
        tapes = draw_tapes(problems[0], seed, 0, min(_BLOCK, rollouts - first), first)
        for verdicts, problem in zip(outcomes, problems, strict=True):
            verdicts.append(runner(problem, tapes, parameter))
    low, high = map(Verdicts.join, outcomes)
    broken = low.broken | high.broken
    both = int((low.fails & high.fails).sum())
    only_low, only_high = int((low.fails & high.passes).sum()), int((low.passes & high.fails).sum())
    width, lost = span[1] - span[0], int(broken.sum())
    count = both + only_low + only_high
    if not (both + only_low and both + only_high):
        failures = both + max(only_low, only_high)
        most = clopper_pearson(failures, rollouts, confidence, lost)[1]
        nothing = (-math.inf, math.inf)
        return Sensitivity(parameter, value, math.nan, nothing, "paired", count, span, most=most)
    derivative, (least, most) = _compare(both, only_low, only_high, width, confidence)
    if lost:  # they might have failed at one of the two values alone, at either
        least = _compare(both, only_low + lost, only_high, width, confidence)[1][0]
        most = _compare(both, only_low, only_high + lost, width, confidence)[1][1]
    return Sensitivity(parameter, value, derivative, (least, most), "paired", count, span)


def _compare(
    both: int, only_low: int, only_high: int, width: float, confidence: float
) -> tuple[float, Interval]:
    ratio = math.log((both + only_high) / (both + only_low))
    # A change seen on no tape has still been looked for on finitely many: half a tape is added.
    error = math.sqrt(max(only_low + only_high, 0.5) / ((both + only_low) * (both + only_high)))
    return ratio / width, normal_interval(ratio / width, error / abs(width), confidence)


def sort_by_effect(rows: Sequence[Sensitivity]) -> tuple[Sensitivity, ...]:
    """Return the rows, the largest relative effect first; those that are unknown last."""
    return tuple(
        sorted(rows, key=lambda row: -abs(row.elasticity) if row.derivative == row.derivative else 1.0)
    )
