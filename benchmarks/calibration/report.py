"""Report: the table of the page, the tables beside it and the figures of the benchmark."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.calibration import cells, figures
from benchmarks.calibration.problems import problems
from benchmarks.calibration.summary import LEAST_ANSWERS, Row, best, compared, rows_of, trusted
from benchmarks.calibration.tools import RECOMMENDED, TOOLS
from benchmarks.studies import pages

PAGE = Path(__file__).parents[2] / "docs" / "calibration.md"
FOLDER = PAGE.with_suffix("")
KEPT = FOLDER / "cells.zip"
_USUAL = 10_000
FEW = 10
"""Dimensions that are few."""
_NOT_SHOWN = {"setting", "budget", "problems", f"covers, d <= {FEW}", f"covers, d > {FEW}", "evaluations"}
Line = dict[str, str]
"""Line of a table: entries by column."""


def write(results: Path) -> None:
    """Write the table of docs/calibration.md, and the files beside it, unless rows would be lost."""
    rows = [row for row in rows_of(cells.read(results)) if row.tool in TOOLS]
    rows.sort(key=lambda row: (list(TOOLS).index(row.tool), row.setting, row.budget))
    if not rows:
        print(f"{results} has no cells, so no page is written")
        return
    text = pages.fill(PAGE.read_text(encoding="utf-8"), "tools", shown_lines(rows))
    if pages.put(PAGE, text, results):
        FOLDER.mkdir(exist_ok=True)
        _write_table("table", cell_table(rows))
        _write_table("tools", tool_table(rows))
        _write_table("first", first_table(rows))
        _write_table("problems", problem_table())
        _write_table("settings", setting_table())
        figures.draw(main_rows(rows), FOLDER)


def main_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of the recommended settings at the budget of most of them, 10,000 if it is one."""
    recommended = [row for row in rows if row.setting == RECOMMENDED]
    counts = Counter(row.budget for row in recommended)
    budget = max(counts, key=lambda budget: (counts[budget], budget == _USUAL), default=_USUAL)
    return [row for row in recommended if row.budget == budget]


def cell_table(rows: Iterable[Row]) -> list[Line]:
    """Return a line for each tool, setting, problem and budget."""
    return [
        {
            "tool": row.tool,
            "version": next((cell.version for cell in row.cells if cell.version), ""),
            "setting": row.setting,
            "problem": row.problem.name,
            "probability": f"{row.problem.probability:.9g}",
            "budget": str(row.budget),
            "answers": str(len(row.cells)),
            "answered": _number(row.answered),
            "mean": _number(row.mean),
            "mean_error": _number(row.mean_error),
            "evaluations": _number(row.evaluations),
            "cost": _number(row.cost),
            "covers": _number(row.covers),
            "width": _number(row.width),
            "confidently_wrong": _number(row.wrong_share),
            "warned": _number(row.warned),
            "seconds": _number(row.seconds),
        }
        for row in rows
    ]


def tool_table(rows: Sequence[Row]) -> list[Line]:
    """Return a line for each tool, setting and budget; shares are in percent."""
    groups: dict[tuple[str, str, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.tool, row.setting, row.budget), []).append(row)
    return [_tool_line(group, rows) for group in groups.values()]


def _tool_line(group: Sequence[Row], rows: Sequence[Row]) -> Line:
    tool, setting, budget = group[0].tool, group[0].setting, group[0].budget
    peers = compared([row for row in rows if (row.setting, row.budget) == (setting, budget)])
    first = sum(best([peer for peer in peers if peer.problem is row.problem]) is row for row in group)
    answers = [cell for row in group for cell in row.cells]
    judged = [row for row in group if len(row.cells) >= LEAST_ANSWERS]
    evaluations = [row.evaluations for row in group if row.answers] or [math.nan]
    return {
        "tool": tool,
        "setting": setting,
        "budget": str(budget),
        "problems": str(len(group)),
        "answers": str(len(answers)),
        "stated": _percent([cell.low is not None for cell in answers]),
        "covers": _percent(_hits(group)),
        f"covers, d <= {FEW}": _percent(_hits(row for row in group if row.problem.dimension <= FEW)),
        f"covers, d > {FEW}": _percent(_hits(row for row in group if row.problem.dimension > FEW)),
        "covers unwarned": _percent(_hits(group, unwarned=True)),
        "width": _number(float(np.median([width for row in group for width in row.widths] or [math.nan]))),
        "confidently wrong": f"{100.0 * sum(row.wrong for row in group) / len(answers):.1f}",
        "warned": _percent([bool(cell.warnings) for cell in answers]),
        "trusted on": str(sum(map(trusted, group))) if judged else "",
        "first on": str(first) if any(row in peers for row in judged) else "",
        "evaluations": _number(float(np.mean(evaluations))),
        "CPU s": f"{sum(row.seconds for row in group) / len(group):.1f}",
    }


def shown_lines(rows: Sequence[Row]) -> list[str]:
    """Return the table of the page: the tools at the main budget."""
    lines = tool_table(main_rows(rows))
    columns = [name for name in lines[0] if name not in _NOT_SHOWN]
    entries = [columns, ["---"] * len(columns), *([line[name] for name in columns] for line in lines)]
    return [f"| {' | '.join(row)} |" for row in entries]


def first_table(rows: Sequence[Row]) -> list[Line]:
    """Return who is first on each problem at the main budget, and how far the best of avrare is behind."""
    peers, lines = compared(main_rows(rows)), []
    for problem in problems().values():
        group = [row for row in peers if row.problem is problem]
        winner = best(group)
        ours = best([row for row in group if row.tool.startswith("avrare")])
        behind = ours.cost / winner.cost if winner and ours and ours is not winner else math.nan
        line = {
            "problem": problem.name,
            "probability": f"{problem.probability:.2g}",
            "dimension": str(problem.dimension),
            "first": winner.tool if winner else "none",
            "its cost": _number(winner.cost) if winner else "",
            "best of avrare": ours.tool if ours else "none",
            "cost of avrare": _number(ours.cost) if ours else "",
            "behind": _number(behind),
            "Monte Carlo's": _number((1.0 - problem.probability) / problem.probability),
        }
        lines += [line] if group else []
    return lines


def problem_table() -> list[Line]:
    """Return a line for each problem."""
    return [
        {
            "problem": problem.name,
            "dimension": str(problem.dimension),
            "probability": f"{problem.probability:.6g}",
            "traits": ", ".join(problem.traits),
            "truth": problem.source,
        }
        for problem in problems().values()
    ]


def setting_table() -> list[Line]:
    """Return a line for each setting of a tool: options, size for a budget of B, origin of the interval."""
    return [
        {
            "tool": tool.name,
            "setting": name,
            "options": ", ".join(f"{key} {value}" for key, value in options.items()),
            "size": tool.sized,
            "interval": tool.interval,
        }
        for tool in TOOLS.values()
        for name, options in tool.settings.items()
    ]


def _write_table(name: str, lines: Sequence[Line]) -> None:
    with (FOLDER / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(lines[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


def _hits(rows: Iterable[Row], unwarned: bool = False) -> list[bool]:
    """Return whether each stated interval holds the truth."""
    return [
        cell.low <= row.problem.probability <= cell.high
        for row in rows
        for cell in row.stated
        if cell.low is not None and cell.high is not None and not (unwarned and cell.warnings)
    ]


def _percent(hits: Sequence[bool]) -> str:
    return f"{100.0 * sum(hits) / len(hits):.1f}" if hits else ""


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.4g}"
