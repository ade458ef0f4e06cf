"""Comparison of estimators: what each of them gave, and how well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from avrare.analysis.compare.case import ENOUGH_FAILURES, POOLED, ComparisonCase, GroundTruth
from avrare.analysis.compare.estimator_options import Arm
from avrare.analysis.compare.repetition_statistics import (
    MIN_REPETITIONS,
    Summary,
    find_disagreements,
    summarise,
)
from avrare.base.errors import AvrareError
from avrare.base.number_format import format_confidence, format_narrow
from avrare.base.records import Answer, Records
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.note import list_error_notes
from avrare.estimation.result.result import Result


@dataclass(frozen=True)
class StudyDesign:
    """Settings that all estimates of a study share."""

    budget: Budget  # of each estimate, in steps or rollouts
    repeat: int = 10  # repetition number r has the seed ``seed + r``
    seed: int = 0
    workers: int = 1  # no number depends on them


@dataclass(frozen=True)
class ArmResult:
    """Estimates of one estimator, in the order of their seeds, without tapes."""

    arm: Arm
    repetitions: tuple[Result, ...] = ()
    refusal: AvrareError | None = None  # if it cannot take the problem; its estimates enter no statistic


@dataclass(frozen=True, repr=False)
class Comparison(Answer):
    """Result of a study.

    Attributes:
        case: The problem.
        design: Settings that all estimates share.
        arms: The estimates of each estimator.
        truth: The true probability; None where it is unknown.
        interrupted: Repetitions are missing.
    """

    case: ComparisonCase
    design: StudyDesign
    arms: tuple[ArmResult, ...]
    truth: GroundTruth | None = None
    interrupted: bool = False

    @cached_property
    def summaries(self) -> tuple[Summary | None, ...]:
        """Statistics of each estimator; None for one that was refused.

        Where the truth is computed from repetitions of Monte Carlo, these are not judged against it.
        """
        steps, truth = self.case.problem.steps, self.truth
        pooled = truth is not None and truth.source == POOLED
        return tuple(
            None
            if arm.refusal
            else summarise(
                arm.repetitions,
                None if pooled and arm.arm.name == "mc" else truth,
                steps,
                self.case.confidence,
            )
            for arm in self.arms
        )

    def headline(self) -> list[str]:
        """Return the problem, and the settings of the study."""
        case, design, truth = self.case, self.design, self.truth
        p = "p unknown" if truth is None else f"p = {format_narrow(truth.probability, 4)} ({truth.source})"
        budget = f"{design.budget.amount:,.0f} {design.budget.kind} for each estimate"
        seeds = f"{design.repeat} repetition{'s' * (design.repeat > 1)} from seed {design.seed}"
        return [f"{case.title}  {p}", f"{budget}, {seeds}, {format_confidence(case.confidence)} intervals"]

    def summary(self) -> list[str]:
        """Return ``mc: 0.012 (0.0098..0.014)`` for each estimator, or why it was refused."""
        return [
            f"{arm.arm.label}: {arm.refusal.message if arm.refusal else _format_mean(summary)}"
            for arm, summary in zip(self.arms, self.summaries, strict=True)
        ]

    def notes(self) -> list[str]:
        """Return refusals, remarks on single estimators, and the source of the truth."""
        labels = [result.arm.label for result in self.arms]
        lines = [
            f"{result.arm.label} cannot take this problem: {result.refusal.message}"
            for result in self.arms
            if result.refusal
        ]
        lines += _truth_notes(self.truth)
        if self.design.repeat < MIN_REPETITIONS:
            lines.append(f"one repetition has no spread: make {MIN_REPETITIONS} or more")
        for label, summary, arm in zip(labels, self.summaries, self.arms, strict=True):
            if summary:
                lines += [f"{label}: {text}" for text in _describe_first_errors(arm.repetitions)]
                lines += [f"{label}: {text}" for text in _summary_notes(summary)]
                # A run that has begun may end a little beyond the budget.
                if (times := self._count_budgets(summary)) > 1.05:
                    lines.append(f"{label}: takes {times:.2g} times the budget")
        for first, second in find_disagreements(labels, self.summaries):
            lines.append(f"{first} and {second} disagree: the intervals of their means do not overlap")
        if self.interrupted:
            repetitions = min(len(result.repetitions) for result in self.arms if not result.refusal)
            lines.append(f"interrupted: {repetitions} of {self.design.repeat} repetitions are complete")
        return lines

    def _count_budgets(self, summary: Summary) -> float:
        budget, steps = self.design.budget, max(self.case.problem.steps, 1)
        return summary.simulations * (steps if budget.kind == "steps" else 1) / budget.amount

    def table(self) -> Records:
        """Return one row for each estimator."""
        return Records(
            _make_row(arm, summary) for arm, summary in zip(self.arms, self.summaries, strict=True)
        )

    def lines(self) -> list[str]:
        """Return the settings, the mean of each estimator, and the notes."""
        return [*self.headline(), *self.summary(), *self.notes()]


def _describe_first_errors(repetitions: Sequence[Result]) -> list[str]:
    """Return what the first repetition with errors says of them."""
    texts = (
        [each.health["errors"]] if "errors" in each.health else list_error_notes(each.notes)
        for each in repetitions
    )
    return next(filter(None, texts), [])


def _make_row(arm: ArmResult, summary: Summary | None) -> dict[str, object]:
    accuracy = None if summary is None else summary.accuracy
    low, high = (None, None) if summary is None or summary.interval is None else summary.interval
    return {
        "estimator": arm.arm.label,
        "mean": summary and summary.mean,
        "low": low,
        "high": high,
        "ratio": accuracy and accuracy.ratio,
        "relative_rmse": accuracy and accuracy.relative_rmse,
        "covered": accuracy and accuracy.covered,
        "repetitions": summary and summary.repetitions,
        "rollouts": summary and summary.rollouts,
        "steps": summary and summary.steps,
        "work": accuracy and accuracy.work,
        "speed_up": accuracy and accuracy.speed_up,
        "warned": summary and summary.warned,
        "zeros": summary and summary.zeros,
        "refusal": arm.refusal and arm.refusal.message,
    }


def _format_mean(summary: Summary | None) -> str:
    if summary is None:
        return "-"
    if summary.interval is None:
        return format_narrow(summary.mean)
    low, high = map(format_narrow, summary.interval)
    return f"{format_narrow(summary.mean)} ({low}..{high})"


def _truth_notes(truth: GroundTruth | None) -> list[str]:
    if truth is None:
        return [f"the truth is unknown: give it, or an mc with {ENOUGH_FAILURES} failures in all"]
    if truth.failures is None:
        return []
    error = truth.failures**-0.5
    line = f"the truth is a Monte Carlo estimate from {truth.failures} failures: relative error {error:.0%}"
    if truth.source == POOLED:
        line += ", made of the mc repetitions themselves, which are not judged by it"
    return [line]


def _summary_notes(summary: Summary) -> list[str]:
    lines = []
    if summary.warnings:
        counts = ", ".join(f"{name} in {n}" for name, n in summary.warnings.items())
        lines.append(f"health warnings: {counts} of {summary.repetitions} repetitions")
    if summary.accuracy and summary.zeros == summary.repetitions:
        lines.append("no failures: its numbers say nothing about its speed")
    elif summary.accuracy and summary.accuracy.missed:
        lines.append("its mean misses the truth: biased, or rare large estimates are still missing")
    elif 2 * summary.zeros >= summary.repetitions:
        lines.append("most estimates are zero: a few more repetitions may change its numbers a lot")
    return lines
