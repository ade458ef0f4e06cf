"""Table of rules on many recorded drives: totals, the worst drives, and what could not be scored."""

from __future__ import annotations

import math
from collections import Counter

from avrare.analysis.monitor.batch import BatchResult, DriveScore, Refusal
from avrare.base.number_format import format_robustness
from avrare.output.terminal.console import Mode, make_console, make_table, print_table

_SHOWN = 5


def print_batch(result: BatchResult, mode: Mode = "auto") -> None:
    """Print a line for every rule, its worst drives, and the refusals by reason."""
    console = make_console(mode)
    if result.totals:
        numbers = ("drives", "violated", "violations", "per hour", "per km", "hours", "km")
        table = make_table(None, ("rule",), numbers)
        for total in result.totals:
            counts = map(str, (total.drives, total.violated, total.violations))
            rates = map(_format, (total.per_hour, total.per_kilometre, total.hours, total.kilometres))
            table.add_row(total.rule, *counts, *rates)
        print_table(console, table)
    for total in result.totals:
        for score in result.find_worst(total.rule, _SHOWN):
            console.print(_describe_score(score), markup=False)
    for line in _describe_refusals(result.refusals):
        console.print(line, style="yellow", markup=False)


def _format(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"


def _describe_score(score: DriveScore) -> str:
    by = f" by {score.vehicles}" if score.vehicles else ""
    several = f", {score.violations} violations" if score.violations > 1 else ""
    worst = f"{format_robustness(score.robustness)} at {score.worst:.4g} s{by}"
    return f"{score.rule}  {score.file} ego {score.ego}: {worst}{several}"


def _describe_refusals(refusals: tuple[Refusal, ...]) -> list[str]:
    lines = [f"not read: {one.reason}" for one in refusals if not one.ego]
    reasons = Counter(one.reason for one in refusals if one.ego)
    lines += [f"not scored: {reason}" for reason in list(reasons)[:_SHOWN]]
    if len(reasons) > _SHOWN:
        lines.append(f"not scored: {len(reasons) - _SHOWN} more")
    return lines
