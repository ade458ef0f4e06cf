"""Table of two versions that were compared on the same noise."""

from __future__ import annotations

import math

from rich.markup import escape
from rich.table import Table

from avrare.analysis.compare.paired_comparison import PairedComparison
from avrare.base.number_format import (
    format_confidence,
    format_difference,
    format_probability,
    format_signed_interval,
)
from avrare.output.terminal.console import make_table

_COLOURS = {"worse": "red", "better": "green", "same": "green", "not known": "yellow"}


def paired_table(paired: PairedComparison) -> Table:
    """Return one row per specification."""
    level = f"{format_confidence(paired.confidence)} interval"
    numbers = ("first", "second", "change", level, "first / second", *paired.changes[0].numbers)
    table = make_table(None, ["specification"], numbers)
    table.add_column("", no_wrap=True)
    for change in paired.changes:
        verdict, versions = change.verdict(paired.confidence), (change.first, change.second)
        table.add_row(
            escape(change.specification),
            *("not known" if math.isnan(value) else format_probability(value) for value in versions),
            "not known" if math.isnan(change.difference) else format_difference(change.difference),
            format_signed_interval(change.interval(paired.confidence)),
            change.describe_ratio(paired.confidence),
            *(f"{value:.2g}" if value < 1.0 else f"{value:,.0f}" for value in change.numbers.values()),
            f"[{_COLOURS[verdict]}]{verdict}[/]",
        )
    return table
