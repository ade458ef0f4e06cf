"""Report: the page, the table and the figures of the benchmark."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import ascii_lowercase

import numpy as np

from benchmarks.calibration import cells, figures, scope
from benchmarks.calibration.problems import problems
from benchmarks.calibration.summary import LEAST_ANSWERS, Row, best, compared, rows_of, trusted
from benchmarks.calibration.tools import RECOMMENDED, TOOLS
from benchmarks.calibration.words import ABSENT, FINDINGS, HEAD, NOTES, OWN, REASONS, UNSTRUCTURED
from benchmarks.studies import pages

DOCS = Path(__file__).parents[2] / "docs"
KEPT = DOCS / "calibration" / "cells.zip"
_USUAL = 10_000
_RARE = [name for name in TOOLS if name.startswith("avrare") and name != "avrare mc"]
_NO_LEAD = {"no structure", "nothing to follow"}
"""Traits of problems where nothing leads to a failure."""
_COLUMNS = (
    "tool", "version", "setting", "problem", "probability", "budget", "answers", "answered", "mean",
    "mean_error", "evaluations", "cost", "covers", "width", "confidently_wrong", "warned", "seconds",
)  # fmt: skip


def write(results: Path) -> None:
    """Write docs/calibration.md, and its table and figures, unless rows of the page would be lost."""
    rows = rows_of(cells.read(results))
    rows = [row for row in rows if row.tool in TOOLS]
    rows.sort(key=lambda row: (list(TOOLS).index(row.tool), row.setting, row.budget))
    if not rows:
        print(f"{results} has no cells, so no page is written")
        return
    if pages.put(DOCS / "calibration.md", page(rows), results):
        folder = DOCS / "calibration"
        folder.mkdir(exist_ok=True)
        (folder / "table.csv").write_text(table(rows), encoding="utf-8")
        figures.draw(main_rows(rows), folder)


def main_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of the recommended settings at the budget of most of them, 10,000 if it is one."""
    recommended = [row for row in rows if row.setting == RECOMMENDED]
    counts = Counter(row.budget for row in recommended)
    budget = max(counts, key=lambda one: (counts[one], one == _USUAL), default=_USUAL)
    return [row for row in recommended if row.budget == budget]


def table(rows: Iterable[Row]) -> str:
    """Return the machine-readable table."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for row in rows:
        numbers = (
            row.answered, row.mean, row.mean_error, row.evaluations, row.cost, row.covers, row.width,
            row.wrong_share, row.warned, row.seconds,
        )  # fmt: skip
        version = next((cell.version for cell in row.cells if cell.version), "")
        writer.writerow([
            row.tool, version, row.setting, row.problem.name, f"{row.problem.probability:.9g}", row.budget,
            len(row.cells), *("" if math.isnan(number) else f"{number:.4g}" for number in numbers),
        ])  # fmt: skip
    return text.getvalue()


def page(rows: Sequence[Row]) -> str:
    """Return the page."""
    shown = main_rows(rows)
    peers = compared(shown)
    judged = [row for row in peers if _judged(row)] or shown
    facts = {
        "problems": len({row.problem.name for row in rows}),
        "cells_text": scope.cells_text(rows, shown), "missing_text": scope.missing_text(rows, shown),
        "dimension_text": "\n".join(scope.dimension_lines(shown)), "truth_text": scope.truth_text(),
        "warned_text": scope.warned_text(shown),
        **scope.resolution(scope.typical_seeds(shown)),
        **scope.order(scope.typical_seeds(judged)),
    }  # fmt: skip
    return "\n".join([
        HEAD.format(**facts), *_tool_table(rows), "", NOTES.format(**facts), *_first_table(peers), "",
        "### Where each is first", "", *scope.wins_lines(_winners(peers), peers), "",
        "### Where there was no answer", "", *scope.silent_lines(shown), "",
        OWN, FINDINGS, *_setting_table(), "", *_unable_lines(), "",
        "## Problems", "", ABSENT, *_problem_table(), "",
    ])  # fmt: skip


def _judged(row: Row) -> bool:
    """Return whether a tool was asked often enough to be judged."""
    return len(row.cells) >= LEAST_ANSWERS


def _winners(peers: Sequence[Row]) -> list[tuple[str, str]]:
    """Return the pairs of problem and tool that is first on it."""
    found = [(name, best([row for row in peers if row.problem is one])) for name, one in problems().items()]
    return [(name, winner.tool) for name, winner in found if winner]


def _tool_table(rows: Sequence[Row]) -> list[str]:
    lines = [
        "| tool | setting | budget | problems | answers | stated an interval | covers | width "
        "| confidently wrong | warned | trusted on | first on | evaluations | CPU s |",
        f"|{'---|' * 14}",
    ]
    groups: dict[tuple[str, str, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.tool, row.setting, row.budget), []).append(row)
    for (tool, setting, budget), own in groups.items():
        peers = compared([row for row in rows if (row.setting, row.budget) == (setting, budget)])
        total = sum(len(row.cells) for row in own)
        stated = sum(len(row.stated) for row in own)
        covered = sum(row.covers * len(row.stated) for row in own if row.stated)
        first = sum(best([one for one in peers if one.problem is row.problem]) is row for row in own)
        entries = (
            tool, setting, f"{budget:,}", str(len(own)), str(total), _percent(stated, total),
            _percent(covered, stated), _width(own), _percent(sum(row.wrong for row in own), total),
            _percent(sum(row.warned * len(row.cells) for row in own), total),
            str(sum(map(trusted, own))) if any(map(_judged, own)) else "",
            str(first) if any(_judged(row) and row in peers for row in own) else "",
            _number(float(np.mean([row.evaluations for row in own if row.answers] or [math.nan]))),
            f"{sum(row.seconds for row in own) / len(own):.1f}",
        )  # fmt: skip
        lines.append(f"| {' | '.join(entries)} |")
    return lines


def _first_table(rows: Sequence[Row]) -> list[str]:
    """Return who is first on each problem, and how far the best of avrare is behind."""
    lines = [
        "| problem | p | d | first | its cost | best of avrare | its cost | behind | why | Monte Carlo's |",
        f"|{'---|' * 10}",
    ]
    letters: dict[str, str] = {}
    for problem in problems().values():
        own = [row for row in rows if row.problem is problem]
        winner = best(own)
        ours = best([row for row in own if row.tool.startswith("avrare")])
        if not own:
            continue
        lost = winner is not None and winner is not ours
        behind = f"{ours.cost / winner.cost:.1f}" if ours and winner and lost else ""
        learnt = [row for row in own if row.tool in _RARE and len(row.answers) >= LEAST_ANSWERS]
        reason = ""
        if winner and lost:
            cause = UNSTRUCTURED if _NO_LEAD & set(problem.traits) else winner.tool
            if not learnt:
                reason = "not run"
            elif cause not in REASONS:
                reason = "**reason missing**"
            else:
                reason = letters.setdefault(cause, ascii_lowercase[len(letters)])
        p = problem.probability
        entries = (
            problem.name, f"{p:.2g}", str(problem.dimension), winner.tool if winner else "none",
            _number(winner.cost) if winner else "", ours.tool.split(" ", 1)[1] if ours else "none",
            _number(ours.cost) if ours else "", behind, reason, _number((1.0 - p) / p),
        )  # fmt: skip
        lines.append(f"| {' | '.join(entries)} |")
    told = [f"- **{letter}**, {cause}: {REASONS[cause]}" for cause, letter in letters.items()]
    return [*lines, "", *told]


def _setting_table() -> list[str]:
    lines = [
        f"| tool | interval | size | settings | answers at {', '.join(f'{b:,}' for b in scope.BUDGETS)} |",
        "|---|---|---|---|---|",
    ]
    for tool in TOOLS.values():
        settings = "; ".join(
            f"{name}: {', '.join(f'{key} {value}' for key, value in options.items()) or 'defaults'}"
            for name, options in tool.settings.items()
        )
        answers = ", ".join(str(scope.planned(tool, RECOMMENDED, budget)) for budget in scope.BUDGETS)
        lines.append(f"| {tool.name} | {tool.interval} | {tool.sized} | {settings} | {answers} |")
    return lines


def _unable_lines() -> list[str]:
    """Return which tools cannot express which problems."""
    lines = []
    for tool in TOOLS.values():
        reasons = Counter(filter(None, map(tool.unable, problems().values())))
        lines += [f"- {tool.name}: {reason} ({count} problems)." for reason, count in reasons.items()]
    return ["What a tool cannot express was not asked of it:", "", *lines] if lines else []


def _problem_table() -> list[str]:
    lines = ["| problem | d | p | traits | truth |", "|---|---|---|---|---|"]
    lines += [
        f"| {one.name} | {one.dimension} | {one.probability:.6g} | {', '.join(one.traits)} | {one.source} |"
        for one in problems().values()
    ]
    return lines


def _percent(part: float, of: float) -> str:
    return f"{100.0 * part / of:.1f}" if of else ""


def _width(rows: Sequence[Row]) -> str:
    """Return the median width of the intervals of some rows."""
    widths = [width for row in rows for width in row.widths]
    if not widths:
        return ""
    median = float(np.median(widths))
    return f"{median:.1f}" if median < 100.0 else "100 and more"


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:,.0f}" if value >= 10 else f"{value:.2g}"
