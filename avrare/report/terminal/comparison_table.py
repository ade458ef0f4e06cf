"""Table of a comparison, for the terminal and as Markdown, with the notes below it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from rich.markup import escape
from rich.table import Table

from avrare.analysis.compare.case import ENOUGH_FAILURES, POOLED, GroundTruth
from avrare.analysis.compare.repetition_statistics import (
    MIN_REPETITIONS,
    Accuracy,
    Summary,
    find_disagreements,
)
from avrare.analysis.compare.study import ArmResult, Comparison
from avrare.base.number_format import format_amount, format_confidence, format_narrow
from avrare.base.visible_text import escape_markdown, spell_line
from avrare.estimation.result import Interval
from avrare.report.documents.comparison_documents import summarise_arms
from avrare.report.terminal.console import make_table


class _Cell(NamedTuple):
    value: str = "-"
    interval: str = ""


_Column = tuple[str, Callable[[Summary], _Cell]]  # head of one or two lines, cell of an estimator


def _make_columns(comparison: Comparison) -> list[_Column]:
    static = comparison.case.problem.steps == 0
    return [
        ("mean\nestimate", _mean),
        ("/ truth", _with_accuracy(lambda a: _Cell(f"{a.ratio:.3g}"))),
        ("rel.\nRMSE", _with_accuracy(lambda a: _Cell(f"{a.relative_rmse:.2g}"))),
        ("covers\ntruth", _coverage),
        ("cost\n[rollouts]", lambda s: _Cell(format_amount(s.rollouts, 3))) if static
        else ("cost\n[steps]", lambda s: _Cell(format_amount(s.steps, 3))),
        ("relMSE\nx cost", _with_accuracy(_work)),
        ("speed-up\nover MC", _with_accuracy(_speed_up)),
        ("warned", lambda s: _Cell(f"{s.warned}/{s.repetitions}")),
        ("zero", lambda s: _Cell(f"{s.zeros}/{s.repetitions}")),
    ]  # fmt: skip


def headline(comparison: Comparison) -> list[str]:
    """Return the problem, and the settings of the study."""
    case, design, truth = comparison.case, comparison.design, comparison.truth
    p = "p unknown" if truth is None else f"p = {format_narrow(truth.probability, 4)} ({truth.source})"
    budget = f"{design.budget.amount:,.0f} {design.budget.kind} for each estimate"
    seeds = f"{design.repeat} repetition{'s' * (design.repeat > 1)} from seed {design.seed}"
    return [f"{case.title}  {p}", f"{budget}, {seeds}, {format_confidence(case.confidence)} intervals"]


def comparison_table(comparison: Comparison) -> Table:
    """Return one row per estimator, with intervals below their numbers."""
    table = make_table(leading=0)
    columns = _make_columns(comparison)
    table.add_column("estimator", max_width=26, overflow="fold")
    for head, _ in columns:
        table.add_column(head, justify="right", no_wrap=True)
    for result, cells in _rows(comparison, columns):
        table.add_row("\n:".join(map(escape, result.arm.label_parts)), *map(_stack, cells))
    return table


def markdown(comparison: Comparison) -> str:
    """Return the table with its headline and notes."""
    columns = _make_columns(comparison)
    heads = ["estimator", *(head.replace("-\n", "").replace("\n", " ") for head, _ in columns)]
    title, settings = headline(comparison)
    lines = [f"# {escape_markdown(title)}", "", escape_markdown(settings), ""]
    lines += [_markdown_row(heads), _markdown_row(["---", *("---:" for _ in columns)])]
    for result, cells in _rows(comparison, columns):
        lines.append(_markdown_row([_code(result.arm.label), *map(_in_line, cells)]))
    lines += ["", *(f"- {escape_markdown(line)}" for line in note_lines(comparison))]
    return "\n".join(lines).rstrip() + "\n"


def _rows(comparison: Comparison, columns: Sequence[_Column]) -> list[tuple[ArmResult, list[_Cell]]]:
    return [
        (result, [cell(summary) if summary else _Cell() for _, cell in columns])
        for result, summary in zip(comparison.arms, summarise_arms(comparison), strict=True)
    ]


def summary_lines(comparison: Comparison) -> list[str]:
    """Return ``mc: 0.012 (0.0098..0.014)`` for each estimator, or why it was refused."""
    return [
        f"{result.arm.label}: {result.refusal.message if result.refusal else _in_line(cell)}"
        for result, (cell,) in _rows(comparison, [("", _mean)])
    ]


def note_lines(comparison: Comparison) -> list[str]:
    """Return refusals, remarks on single rows, and the source of the truth."""
    labels = [result.arm.label for result in comparison.arms]
    summaries = summarise_arms(comparison)
    lines = [
        f"{result.arm.label} cannot take this problem: {result.refusal.message}"
        for result in comparison.arms
        if result.refusal
    ]
    lines += _truth_notes(comparison.truth)
    if comparison.design.repeat < MIN_REPETITIONS:
        lines.append(f"one repetition has no spread: give --repeat {MIN_REPETITIONS} or more")
    for label, summary in zip(labels, summaries, strict=True):
        if summary:
            lines += [f"{label}: {text}" for text in _summary_notes(summary)]
    for one, other in find_disagreements(labels, summaries):
        lines.append(f"{one} and {other} disagree: the intervals of their means do not overlap")
    if comparison.interrupted:
        done = min(len(result.repetitions) for result in comparison.arms if not result.refusal)
        lines.append(f"interrupted: {done} of {comparison.design.repeat} repetitions are complete")
    return lines


def _truth_notes(truth: GroundTruth | None) -> list[str]:
    if truth is None:
        return [f"the truth is unknown: give --truth, or an mc with {ENOUGH_FAILURES} failures in all"]
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


def _mean(summary: Summary) -> _Cell:
    return _Cell(format_narrow(summary.mean), _interval(summary.interval, format_narrow))


def _coverage(summary: Summary) -> _Cell:
    accuracy = summary.accuracy
    if accuracy is None:
        return _Cell()
    interval = _interval(accuracy.covered_interval, lambda share: f"{100.0 * share:.0f}")
    return _Cell(f"{accuracy.covered}/{summary.repetitions}", f"{interval}%")


def _work(accuracy: Accuracy) -> _Cell:
    return _Cell(format_amount(accuracy.work), _interval(accuracy.work_interval, format_amount))


def _speed_up(accuracy: Accuracy) -> _Cell:
    if accuracy.speed_up is None:
        return _Cell()
    return _Cell(f"{format_amount(accuracy.speed_up)}x", _interval(accuracy.speed_up_interval, format_amount))


def _with_accuracy(cell: Callable[[Accuracy], _Cell]) -> Callable[[Summary], _Cell]:
    return lambda summary: cell(summary.accuracy) if summary.accuracy else _Cell()


def _interval(interval: Interval | None, form: Callable[[float], str]) -> str:
    return f"{form(interval[0])}..{form(interval[1])}" if interval else ""


def _in_line(cell: _Cell) -> str:
    return f"{cell.value} ({cell.interval})" if cell.interval else cell.value


def _stack(cell: _Cell) -> str:
    return f"{cell.value}\n[dim]{cell.interval}[/dim]" if cell.interval else cell.value


def _code(text: str) -> str:
    return f"`{spell_line(text).replace('`', chr(39))}`"


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
