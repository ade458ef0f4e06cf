"""Console of the command line: output modes, verdict colours, and tables at their own width."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Literal

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from avrare.base.visible_text import spell_controls

Mode = Literal["auto", "plain", "quiet"]
VERDICT_COLOURS = {"pass": "green", "pass_assuming": "cyan", "fail": "red", "inconclusive": "yellow"}


def make_console(mode: Mode = "auto", **options: Any) -> Console:
    """Return a console on stdout; in plain mode without colours on any terminal."""
    if mode == "plain":
        options |= {"color_system": None, "force_terminal": False}
    return _Console(**{"soft_wrap": True, "highlight": False} | options)


class _Console(Console):
    """Console on which a name from a file cannot command the terminal."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(spell_controls(segment.text), segment.style)

    def on_broken_pipe(self) -> None:
        """Raise the errors of ``print``; rich would end the program here and now."""
        raise BrokenPipeError


def make_table(
    title: str | None = None, texts: Sequence[str] = (), numbers: Sequence[str] = (), **options: Any
) -> Table:
    """Return an empty table in the common style, with columns of texts and then of numbers.

    Markup in the title is not read.
    """
    table = Table(
        title=None if title is None else Text(title, "bold"),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        show_edge=False,
        padding=(0, 1, 0, 0),
        **options,
    )
    for name in texts:
        table.add_column(name, no_wrap=True)
    for name in numbers:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def print_table(console: Console, table: Table) -> None:
    """Print a table at its own width: a narrower terminal wraps it, and no number is cut."""
    room = console.options.update(max_width=10_000)
    # The ``width`` of ``print`` only narrows.
    console.width = max(console.width, Measurement.get(console, room, table).maximum)
    console.print(table)


def print_lines(console: Console, lines: Iterable[str], style: str | None = None) -> None:
    """Print lines as they are: markup in them is not read."""
    for line in lines:
        console.print(line, style=style, markup=False)


def colour_verdict(verdict: str | None) -> str:
    """Return a verdict as console markup; a dash for None."""
    return f"[{VERDICT_COLOURS[verdict]}]{verdict}[/]" if verdict else "-"
