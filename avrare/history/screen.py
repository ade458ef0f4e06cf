"""A history for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.markup import escape
from rich.table import Table

from avrare.history.entry import Entry, breaks
from avrare.report.console import coloured, number

CHANGED = "≠"


def table(scenario: str, specification: str, found: Sequence[Entry]) -> Table:
    """The estimates of one specification, the oldest first."""
    view = Table(
        title=escape(f"{scenario}  {specification}"), title_justify="left", title_style="bold",
        box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, padding=(0, 1, 0, 0),
    )  # fmt: skip
    view.add_column("date", no_wrap=True)
    view.add_column("commit", no_wrap=True)
    view.add_column("", no_wrap=True)
    for name in ("probability", "interval"):
        view.add_column(name, justify="right", no_wrap=True)
    view.add_column("verdict", no_wrap=True)
    for entry, other in zip(found, breaks(found), strict=True):
        view.add_row(
            f"{entry.when:%Y-%m-%d %H:%M}", escape(entry.commit), f"[yellow]{CHANGED}[/]" if other else "",
            number(entry.probability), f"{number(entry.low, 2)} .. {number(entry.high, 2)}",
            coloured(entry.verdict or None),
        )  # fmt: skip
    return view


def notes(found: Sequence[Entry], broken: bool) -> list[str]:
    """What to know when reading the tables."""
    lines = []
    if broken:
        lines.append(f"{CHANGED} the scenario or a version is another one than in the row above")
    if any(entry.changed for entry in found):
        lines.append("* with uncommitted changes")
    warned = [entry for entry in found if entry.health]
    for entry in warned:
        place = f"{entry.scenario} {entry.specification} {entry.when:%Y-%m-%d %H:%M}"
        lines.append(f"{place}: warned of {entry.health.replace(',', ', ')}")
    return lines
