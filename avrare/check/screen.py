"""What a person sees of a check: a table of verdicts, reasons below it, and what a plan costs."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from avrare.check.document import change
from avrare.check.gate import Outcome
from avrare.check.planner import Estimate
from avrare.errors import ExitCode
from avrare.report.console import number, screen
from avrare.report.progress import Mode

_COLOURS = {"pass": "green", "fail": "red", "inconclusive": "yellow"}
_WIDEST = 400
_WIDTH = 100
"""Columns that a plan needs; a narrower terminal breaks its lines."""


def show(outcome: Outcome, mode: Mode = "auto") -> None:
    """Print the verdicts; in quiet mode a line each and the whole."""
    console = screen(mode)
    if mode == "quiet":
        for line in brief(outcome):
            console.print(line, markup=False)
        return
    table = verdicts(outcome)
    room = console.options.update(max_width=_WIDEST)
    console.width = max(console.width, Measurement.get(console, room, table).maximum)
    console.print(table)
    reasons: dict[tuple[str, str, str], list[str]] = {}
    for one in outcome.rows:
        reasons.setdefault((one.scenario, one.verdict, one.reason), []).append(one.name)
    for (scenario, verdict, reason), names in reasons.items():
        if reason:
            words = f"{scenario}  {', '.join(names)}: {reason}"
            console.print(words, style=_COLOURS[verdict], markup=False)
    for note in outcome.notes:
        console.print(note, markup=False)
    console.print(f"[{_COLOURS[outcome.verdict]}]{outcome.verdict}[/]{_tail(outcome)}")


def brief(outcome: Outcome) -> list[str]:
    """``drive in_lane < 0.1: pass, 0.05 (0.041 .. 0.06)`` for each row and why it does not pass."""
    lines = []
    for one in outcome.rows:
        low, high = one.interval or (0.0, 1.0)
        found = "" if one.probability is None else f", {number(one.probability)}"
        found += f" ({number(low, 2)} .. {number(high, 2)})" if one.interval else ""
        why = f": {one.reason}" if one.reason and one.verdict != "pass" else ""
        lines.append(f"{one.scenario} {one.specification} {one.question}: {one.verdict}{found}{why}")
    return [*lines, f"{outcome.verdict}{_tail(outcome)}"]


def _tail(outcome: Outcome) -> str:
    looks = f" after {outcome.looks} looks" if outcome.looks > 1 else ""
    broken = outcome.exit_code == ExitCode.ROLLOUT_ERRORS
    why = ": more rollouts broke down than the scenario allows" if broken else ""
    return f"{looks}, exit code {int(outcome.exit_code)}{why}"


def verdicts(outcome: Outcome) -> Table:
    """One row a claim."""
    several = len(outcome.results) > 1
    compared = any(one.change_interval for one in outcome.rows)
    view = _table("check  " + ", ".join(outcome.results))
    heads = [*(["scenario"] if several else []), "rule", "wanted"]
    for head in heads:
        view.add_column(head, no_wrap=True)
    for head in ("probability", "interval", *(["baseline", "change"] if compared else [])):
        view.add_column(head, justify="right", no_wrap=True)
    view.add_column("verdict", no_wrap=True)
    for one in outcome.rows:
        low, high = one.interval or (0.0, 1.0)
        numbers = [
            "-" if one.probability is None else number(one.probability),
            f"{number(low, 2)} .. {number(high, 2)}" if one.interval else "-",
        ]
        if compared:
            numbers += ["-" if one.baseline is None else number(one.baseline), change(one)]
        names = [*([one.scenario] if several else []), one.specification, one.question]
        verdict = f"[{_COLOURS[one.verdict]}]{one.verdict}[/]"
        view.add_row(*map(escape, [*names, *numbers]), verdict)
    return view


def show_plan(estimates: Sequence[Estimate], mode: Mode = "auto") -> None:
    """Print what verdicts will cost."""
    console = screen(mode)
    console.width = max(console.width, _WIDTH)
    view = _table("what a verdict costs, about")
    for head in ("scenario", "rule", "wanted"):
        view.add_column(head, no_wrap=True)
    for head in ("simulations", "steps", "time"):
        view.add_column(head, justify="right", no_wrap=True)
    view.add_column("why")
    for one in estimates:
        costs = ["-"] * 3
        if one.rollouts is not None:
            costs = [f"{one.rollouts:,}", f"{one.steps:,}", duration(one.seconds)]
        view.add_row(*map(escape, [one.scenario, one.specification, one.question, *costs, one.reason]))
    console.print(view)


def duration(seconds: float) -> str:
    """``40 s``, ``4 min``, ``3 h``, ``2 days``."""
    for size, unit in ((86_400.0, "days"), (3_600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s" if seconds >= 1.0 else "under 1 s"


def _table(title: str) -> Table:
    return Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
        pad_edge=False, show_edge=False, padding=(0, 1, 0, 0),
    )  # fmt: skip
