"""Tables of a comparison: of estimators, on the terminal and as Markdown, and of two versions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from rich.markup import escape
from rich.table import Table

from avrare.analysis.compare.comparison import ArmResult, Comparison
from avrare.analysis.compare.paired_comparison import PairedComparison
from avrare.analysis.compare.repetition_statistics import (
    Accuracy,
    Summary,
)
from avrare.base.number_format import (
    format_amount,
    format_confidence,
    format_difference,
    format_narrow,
    format_probability,
    format_signed_interval,
)
from avrare.base.visible_text import escape_markdown, spell_line
from avrare.estimation.result.intervals import Interval
from avrare.output.terminal.console import make_table


class _Cell(NamedTuple):
    value: str = "-"
    interval: str = ""


_Column = tuple[str, Callable[[Summary], _Cell]]  # head of one or two lines, cell of an estimator


def _make_columns(comparison: Comparison) -> list[_Column]:
    static = comparison.case.problem.steps == 0
    return [
        ("mean\nestimate", _make_mean_cell),
        ("/ truth", _with_accuracy(lambda a: _Cell(f"{a.ratio:.3g}"))),
        ("rel.\nRMSE", _with_accuracy(lambda a: _Cell(f"{a.relative_rmse:.2g}"))),
        ("covers\ntruth", _make_coverage_cell),
        ("cost\n[rollouts]", lambda s: _Cell(format_amount(s.rollouts, 3)))
        if static
        else ("cost\n[steps]", lambda s: _Cell(format_amount(s.steps, 3))),
        ("relMSE\nx cost", _with_accuracy(_work)),
        ("speed-up\nover MC", _with_accuracy(_speed_up)),
        ("warned", lambda s: _Cell(f"{s.warned}/{s.repetitions}")),
        ("zero", lambda s: _Cell(f"{s.zeros}/{s.repetitions}")),
    ]


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
    title, settings = comparison.headline()
    lines = [f"# {escape_markdown(title)}", "", escape_markdown(settings), ""]
    lines += [_markdown_row(heads), _markdown_row(["---", *("---:" for _ in columns)])]
    for result, cells in _rows(comparison, columns):
        lines.append(_markdown_row([_code(result.arm.label), *map(_in_line, cells)]))
    lines += ["", *(f"- {escape_markdown(line)}" for line in comparison.notes())]
    return "\n".join(lines).rstrip() + "\n"


def _rows(comparison: Comparison, columns: Sequence[_Column]) -> list[tuple[ArmResult, list[_Cell]]]:
    return [
        (result, [cell(summary) if summary else _Cell() for _, cell in columns])
        for result, summary in zip(comparison.arms, comparison.summaries, strict=True)
    ]


def _make_mean_cell(summary: Summary) -> _Cell:
    return _Cell(format_narrow(summary.mean), _interval(summary.interval, format_narrow))


def _make_coverage_cell(summary: Summary) -> _Cell:
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


def paired_table(paired: PairedComparison) -> Table:
    """Return one row per specification."""
    level = f"{format_confidence(paired.confidence)} interval"
    numbers = ("first", "second", "change", level, "first / second", *paired.changes[0].numbers)
    table = make_table(None, ["specification"], numbers)
    table.add_column("", no_wrap=True)
    colours = {"worse": "red", "better": "green", "same": "green", "not known": "yellow"}
    for change in paired.changes:
        verdict, versions = change.verdict(paired.confidence), (change.first, change.second)
        table.add_row(
            escape(change.specification),
            *("not known" if math.isnan(value) else format_probability(value) for value in versions),
            "not known" if math.isnan(change.difference) else format_difference(change.difference),
            format_signed_interval(change.interval(paired.confidence)),
            change.describe_ratio(paired.confidence),
            *(f"{value:.2g}" if value < 1.0 else f"{value:,.0f}" for value in change.numbers.values()),
            f"[{colours[verdict]}]{verdict}[/]",
        )
    return table
