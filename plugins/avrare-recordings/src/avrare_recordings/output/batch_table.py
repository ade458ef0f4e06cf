"""Table of rules on many recorded drives: totals, the worst drives, and refusals."""

from __future__ import annotations

import math

from avrare.output.terminal.console import Mode, make_console, make_table, print_table
from avrare_recordings.batch import BatchResult


def print_batch(result: BatchResult, mode: Mode) -> None:
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
    for line in result.describe_worst():
        console.print(line, markup=False)
    for line in result.describe_refusals():
        console.print(line, style="yellow", markup=False)


def _format(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"
