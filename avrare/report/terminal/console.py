"""Console of the command line: output modes, verdict colours, and tables at their own width."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Literal

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

Mode = Literal["auto", "plain", "quiet"]
VERDICT_COLOURS = {"pass": "green", "fail": "red", "inconclusive": "yellow"}
_MAX_WIDTH = 10_000


def make_console(mode: Mode) -> Console:
    """Return a console on stdout; in plain mode without colours on any terminal."""
    if mode == "plain":
        return Console(soft_wrap=True, highlight=False, color_system=None, force_terminal=False)
    return Console(soft_wrap=True, highlight=False)


def make_table(
    title: str | None = None, texts: Sequence[str] = (), numbers: Sequence[str] = (), **options: Any
) -> Table:
    """Return an empty table in the common style, with columns of texts and then of numbers."""
    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
        pad_edge=False, show_edge=False, padding=(0, 1, 0, 0), **options,
    )  # fmt: skip
    for name in texts:
        table.add_column(name, no_wrap=True)
    for name in numbers:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def print_table(console: Console, table: Table) -> None:
    """Print a table at its own width: a narrower terminal wraps it, and no number is cut."""
    room = console.options.update(max_width=_MAX_WIDTH)
    # The ``width`` of ``print`` only narrows.
    console.width = max(console.width, Measurement.get(console, room, table).maximum)
    console.print(table)


def print_lines(console: Console, lines: Iterable[str], style: str | None = None) -> None:
    """Print lines as they are: square brackets in them are no markup."""
    for line in lines:
        console.print(line, style=style, markup=False)


def colour_verdict(verdict: str | None) -> str:
    """Return a verdict as console markup; a dash for None."""
    return f"[{VERDICT_COLOURS[verdict]}]{verdict}[/]" if verdict else "-"
