"""Table of two versions that were compared on the same noise."""

from __future__ import annotations

from rich.markup import escape
from rich.table import Table

from avrare.analysis.compare.paired_comparison import PairedComparison
from avrare.base.number_format import (
    format_confidence,
    format_probability,
    format_signed,
    format_signed_interval,
)
from avrare.report.terminal.console import make_table
from avrare.scenario.fingerprint import comparable

_FEW_DIFFERENCES = 10  # rollouts with different outcomes below which a note asks for more
_COLOURS = {"worse": "red", "better": "green", "same": "green", "not known": "yellow"}


def headline(paired: PairedComparison) -> str:
    """Return what was compared."""
    first, second = paired.names
    other = second if second != first else f"{second} with other settings"
    return f"{first} against {other}: {paired.rollouts:,} rollouts each, on the same noise"


def paired_table(paired: PairedComparison) -> Table:
    """Return one row per specification."""
    level = f"{format_confidence(paired.confidence)} interval"
    numbers = ("first", "second", "change", level, "mended", "newly failing", "p-value")
    table = make_table(None, ["specification"], numbers)
    table.add_column("", no_wrap=True)
    for counts in paired.counts:
        verdict = counts.verdict(paired.confidence)
        table.add_row(
            escape(counts.specification), format_probability(counts.first), format_probability(counts.second),
            format_signed(counts.difference), format_signed_interval(counts.interval(paired.confidence)),
            str(counts.only_first), str(counts.only_second), f"{counts.p_value:.2g}",
            f"[{_COLOURS[verdict]}]{verdict}[/]",
        )  # fmt: skip
    return table


def summary_lines(paired: PairedComparison) -> list[str]:
    """Return ``safe_distance: worse, +0.012 (+0.004 .. +0.02)`` for each specification."""
    lines = []
    for counts in paired.counts:
        change = format_signed(counts.difference)
        interval = format_signed_interval(counts.interval(paired.confidence))
        lines.append(f"{counts.specification}: {counts.verdict(paired.confidence)}, {change} ({interval})")
    return lines


def note_lines(paired: PairedComparison) -> list[str]:
    """Return remarks for the reader of the table."""
    lines = _note_other_changes(paired)
    for counts in paired.counts:
        if 0 < counts.different < _FEW_DIFFERENCES:
            few = f"{counts.different} rollout{'s' * (counts.different > 1)}"
            lines.append(f"{counts.specification}: only {few} with different outcomes: use more rollouts")
    errors = paired.counts[0].errors
    if errors:
        counts_text = f"{errors} of {paired.rollouts} rollouts ended in an error"
        lines.append(f"{counts_text}: the intervals allow for both outcomes")
    return lines


def _note_other_changes(paired: PairedComparison) -> list[str]:
    """Return which rules differ, and whether the simulators do: what follows is not the stack's change."""
    first, second = map(comparable, paired.scenarios)
    rules = [one.specification for one in paired.counts]
    changed = [name for name in rules if first["specifications"][name] != second["specifications"][name]]
    lines = [f"{', '.join(changed)}: the two versions judge by different rules"] if changed else []
    if first["simulator"] != second["simulator"]:
        lines.append("the two versions have different simulators")
    return [f"{line}: the change is not that of the stack alone" for line in lines]
