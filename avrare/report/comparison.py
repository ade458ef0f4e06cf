"""The table of a comparison, for the terminal and as Markdown, and what to know when reading it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich import box
from rich.markup import escape
from rich.table import Table

from avrare.compare.document import summaries
from avrare.compare.study import Comparison
from avrare.compare.summary import FEWEST, Accuracy, Summary, disagreements
from avrare.compare.truth import ENOUGH_FAILURES
from avrare.estimation.result import Interval

EMPTY = "-"


@dataclass(frozen=True)
class Cell:
    """A number and, below it, its interval."""

    value: str
    interval: str = ""


@dataclass(frozen=True)
class Column:
    """A column of the table.

    Attributes:
        head: One or two lines.
        meaning: For the legend.
        cell: What it says of an estimator.
    """

    head: str
    meaning: str
    cell: Callable[[Summary], Cell]


def columns(static: bool) -> list[Column]:
    """The columns; a static problem has no steps, and its cost is counted in rollouts."""
    cost = (
        Column("cost\n[rollouts]", "mean rollouts", lambda s: Cell(count(s.rollouts, 3)))
        if static
        else Column("cost\n[steps]", "mean simulated steps", lambda s: Cell(count(s.steps, 3)))
    )
    return [
        Column("mean\nestimate", "of the repetitions", _mean),
        Column("/ truth", "mean estimate / truth", _of_truth(lambda a: Cell(f"{a.ratio:.3g}"))),
        Column("rel.\nRMSE", "root of the mean squared relative error", _of_truth(_rmse)),
        Column("covers\ntruth", "repetitions whose interval holds the truth", _coverage),
        cost,
        Column("relMSE\nx cost", "rel. RMSE squared x cost in full simulations", _of_truth(_work)),
        Column("speed-up\nover MC", "(1 - p) / p over relMSE x cost", _of_truth(_speed_up)),
        Column("warned", "repetitions with health warnings", lambda s: Cell(f"{s.warned}/{s.repetitions}")),
        Column("zero", "estimates that are zero", lambda s: Cell(f"{s.zeros}/{s.repetitions}")),
    ]


def headline(comparison: Comparison) -> list[str]:
    """What was compared, on what, and how."""
    case, design, truth = comparison.case, comparison.design, comparison.truth
    p = "p unknown" if truth is None else f"p = {_short(truth.probability, 4)} ({truth.source})"
    budget = f"{design.budget.amount:,.0f} {design.budget.kind} for each estimate"
    seeds = f"{design.repeat} repetition{'s' * (design.repeat > 1)} from seed {design.seed}"
    return [f"{case.title}  {p}", f"{budget}, {seeds}, {case.confidence:.0%} intervals"]


def table(comparison: Comparison) -> Table:
    """One estimator a row, intervals below their numbers."""
    view = Table(
        box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, padding=(0, 1, 0, 0), leading=0,
    )  # fmt: skip
    shown = columns(comparison.case.problem.steps == 0)
    view.add_column("estimator", max_width=26, overflow="fold")
    for column in shown:
        view.add_column(column.head, justify="right", no_wrap=True)
    for entry, summary in zip(comparison.entries, summaries(comparison), strict=True):
        cells = [column.cell(summary) if summary else Cell(EMPTY) for column in shown]
        view.add_row("\n:".join(map(escape, entry.arm.words)), *(_stacked(cell) for cell in cells))
    return view


def markdown(comparison: Comparison) -> str:
    """The table with its heading, legend and notes."""
    shown = columns(comparison.case.problem.steps == 0)
    heads = ["estimator", *(column.head.replace("-\n", "").replace("\n", " ") for column in shown)]
    lines = [f"# {headline(comparison)[0]}", "", headline(comparison)[1], ""]
    lines += [_row(heads), _row(["---", *("---:" for _ in shown)])]
    for entry, summary in zip(comparison.entries, summaries(comparison), strict=True):
        cells = [column.cell(summary) if summary else Cell(EMPTY) for column in shown]
        texts = [f"{cell.value} ({cell.interval})" if cell.interval else cell.value for cell in cells]
        lines.append(_row([f"`{entry.arm.label}`", *texts]))
    lines += ["", *(f"- {line}" for line in notes(comparison))]
    return "\n".join(lines).rstrip() + "\n"


def brief(comparison: Comparison) -> list[str]:
    """A line for each estimator: ``mc: 0.012 (0.0098..0.014)``, or why it cannot."""
    lines = []
    for entry, summary in zip(comparison.entries, summaries(comparison), strict=True):
        found = _mean(summary) if summary else Cell(EMPTY)
        span = f" ({found.interval})" if found.interval else ""
        lines.append(f"{entry.arm.label}: {entry.refusal or f'{found.value}{span}'}")
    return lines


def notes(comparison: Comparison) -> list[str]:
    """What a reader should know: refusals, doubtful rows, where the truth comes from."""
    lines = [
        f"{entry.arm.label} cannot take this problem: {entry.refusal}"
        for entry in comparison.entries
        if entry.refusal
    ]
    lines += _about_truth(comparison)
    if comparison.design.repeat < FEWEST:
        lines.append(f"one repetition has no spread: give --repeat {FEWEST} or more")
    for entry, summary in zip(comparison.entries, summaries(comparison), strict=True):
        if summary:
            lines += [f"{entry.arm.label}: {text}" for text in _about(summary)]
    labels = [entry.arm.label for entry in comparison.entries]
    for one, other in disagreements(labels, summaries(comparison)):
        lines.append(f"{one} and {other} disagree: the intervals of their means have no common point")
    if comparison.interrupted:
        done = min(len(entry.repetitions) for entry in comparison.entries if not entry.refusal)
        lines.append(f"interrupted: {done} of {comparison.design.repeat} repetitions are complete")
    return lines


def _about_truth(comparison: Comparison) -> list[str]:
    truth = comparison.truth
    if truth is None:
        return [f"the truth is not known: give --truth, or an mc that sees {ENOUGH_FAILURES} failures in all"]
    if not truth.estimated:
        return []
    assert truth.failures is not None
    error = truth.failures**-0.5
    line = f"the truth is a Monte Carlo estimate from {truth.failures} failures: relative error {error:.0%}"
    if truth.source.startswith("pooled"):
        line += ", made of the mc repetitions themselves: theirs is no test of it"
    return [line]


def _about(summary: Summary) -> list[str]:
    lines = []
    if summary.warnings:
        counted = ", ".join(f"{name} in {many}" for name, many in summary.warnings.items())
        lines.append(f"warned of {counted} of {summary.repetitions} repetitions")
    if summary.accuracy and summary.zeros == summary.repetitions:
        lines.append("saw no failure: its numbers say nothing about its speed")
    elif summary.accuracy and summary.accuracy.missed:
        lines.append("its mean misses the truth: biased, or its rare large estimates have not been seen yet")
    elif 2 * summary.zeros >= summary.repetitions:
        lines.append("most estimates are zero: a few more repetitions may change its numbers a lot")
    return lines


def _mean(summary: Summary) -> Cell:
    return Cell(_short(summary.mean), _span(summary.interval, _short))


def _coverage(summary: Summary) -> Cell:
    found = summary.accuracy
    if found is None:
        return Cell(EMPTY)
    return Cell(f"{found.covered}/{summary.repetitions}", _span(found.covered_interval, _percent) + "%")


def _rmse(accuracy: Accuracy) -> Cell:
    return Cell(f"{accuracy.relative_rmse:.2g}")


def _work(accuracy: Accuracy) -> Cell:
    return Cell(count(accuracy.work), _span(accuracy.work_interval, count))


def _speed_up(accuracy: Accuracy) -> Cell:
    if accuracy.speed_up is None:
        return Cell(EMPTY)
    return Cell(f"{count(accuracy.speed_up)}x", _span(accuracy.speed_up_interval, count))


def _of_truth(cell: Callable[[Accuracy], Cell]) -> Callable[[Summary], Cell]:
    return lambda summary: cell(summary.accuracy) if summary.accuracy else Cell(EMPTY)


def _span(interval: Interval | None, form: Callable[[float], str]) -> str:
    return f"{form(interval[0])}..{form(interval[1])}" if interval else ""


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f}"


def _short(value: float, digits: int = 2) -> str:
    """A probability: 0.012, 3.4e-5."""
    text = f"{value:.{digits - 1}e}" if 0.0 < value < 1e-3 else f"{value:.{digits}g}"
    return text.replace("e-0", "e-")


def count(value: float, digits: int = 2) -> str:
    """A positive number in a few digits: 0.42, 7.3, 85, 790, 1.2k, 3.4M, 5.6e9."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    power = math.floor(math.log10(float(f"{value:.{digits - 1}e}")))  # of the rounded number: 999.7 is 1.0k
    if power < 0 or power >= 9:
        return f"{value:.{digits}g}".replace("e+0", "e").replace("e+", "e")
    thousands = power // 3
    decimals = max(0, digits - 1 - power % 3)
    return f"{value / 1000.0**thousands:.{decimals}f}{'kM'[thousands - 1] if thousands else ''}"


def _stacked(cell: Cell) -> str:
    return f"{cell.value}\n[dim]{cell.interval}[/dim]" if cell.interval else cell.value


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
