"""What a person sees in the terminal at the end: a table, and what to know when reading it."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from avrare.estimation.result import Result
from avrare.report.progress import Mode
from avrare.report.progress import Progress as Progress

_WIDEST = 10_000
"""Columns of a table whose lines are left to the terminal to wrap."""


def table(title: str, results: Sequence[Result]) -> Table:
    """One row per specification; with verdicts there is no room for seconds in 80 columns."""
    view = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
        pad_edge=False, show_edge=False, padding=(0, 1, 0, 0),
    )  # fmt: skip
    view.add_column("specification", no_wrap=True)
    verdicts = any(result.verdict for result in results)
    errors = any(result.errors for result in results)
    names = ["probability", "interval", "rollouts", "failures", *(["errors"] if errors else [])]
    for name in names if verdicts else [*names, "seconds"]:
        view.add_column(name, justify="right", no_wrap=True)
    if verdicts:
        view.add_column("verdict", no_wrap=True)
    for result in results:
        low, high = result.interval
        row = [
            result.specification, number(result.probability), f"{number(low, 2)} .. {number(high, 2)}",
            str(result.rollouts), str(result.failures.count), *([str(result.errors)] if errors else []),
            coloured(result.verdict) if verdicts else f"{result.seconds:.1f}",
        ]  # fmt: skip
        view.add_row(*row)
    return view


def screen(mode: Mode) -> Console:
    """Stdout; in plain mode without colours, whatever it is."""
    if mode == "plain":
        return Console(soft_wrap=True, highlight=False, color_system=None, force_terminal=False)
    return Console(soft_wrap=True, highlight=False)


def show(console: Console, view: Table) -> None:
    """Print a table at its own width: a terminal that is too narrow wraps it, and no number is cut."""
    room = console.options.update(max_width=_WIDEST)
    # The ``width`` of ``print`` only narrows.
    console.width = max(console.width, Measurement.get(console, room, view).maximum)
    console.print(view)


def verdicts(name: str, results: Sequence[Result]) -> list[str]:
    """One line a specification: ``lane_change safe_distance: pass, 0.0123 (0.01 .. 0.02)``."""
    return [
        f"{name} {one.specification}: {one.verdict or 'no threshold'}, {number(one.probability)} "
        f"({number(one.interval[0], 2)} .. {number(one.interval[1], 2)})"
        for one in results
    ]


def notes(results: Sequence[Result]) -> list[str]:
    """Warnings of all results, and the counters where they are not zero; a shared one stands once."""
    lines: dict[str, list[str]] = {}
    for result in results:
        for name, message in result.health.items():
            lines.setdefault(f"warning {name}: {message}", []).append(result.specification)
        if result.diagnostics.get("goal_reached") is False:
            short = (
                "the run's end came before what `relative_error` or `threshold` asks for: give more rollouts"
            )
            lines.setdefault(short, []).append(result.specification)
        troubles = {name: n for name, n in result.counts.items() if n and name != "solves"}
        if troubles:
            text = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in troubles.items())
            of = f" of {result.counts['solves']} solves" if "solves" in result.counts else ""
            lines.setdefault(text + of, []).append(result.specification)
    everywhere = len(results)
    return [
        text if len(names) == everywhere else f"{', '.join(names)}: {text}" for text, names in lines.items()
    ]


def number(value: float, digits: int = 3) -> str:
    """A probability in a few digits: 0, 0.0123, 3.4e-05."""
    if value == 0.0 or value == 1.0:
        return f"{value:.0f}"
    return f"{value:.{digits}g}" if value >= 1e-3 else f"{value:.1e}"


def coloured(verdict: str | None) -> str:
    """A verdict for the terminal."""
    colours = {"pass": "green", "fail": "red", "inconclusive": "yellow"}
    return f"[{colours[verdict]}]{verdict}[/]" if verdict else "-"
