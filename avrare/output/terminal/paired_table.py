"""Table of two versions that were compared on the same noise."""

from __future__ import annotations

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
    numbers = ("first", "second", "change", level, "mended", "newly failing", "p-value")
    table = make_table(None, ["specification"], numbers)
    table.add_column("", no_wrap=True)
    for counts in paired.counts:
        verdict = counts.verdict(paired.confidence)
        table.add_row(
            escape(counts.specification),
            format_probability(counts.first),
            format_probability(counts.second),
            format_difference(counts.difference),
            format_signed_interval(counts.interval(paired.confidence)),
            str(counts.only_first),
            str(counts.only_second),
            f"{counts.p_value:.2g}",
            f"[{_COLOURS[verdict]}]{verdict}[/]",
        )
    return table
