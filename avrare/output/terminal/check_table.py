"""Table of a check's verdicts with their reasons, and table of predicted costs."""

from __future__ import annotations

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from avrare.analysis.check.gate import CheckResult
from avrare.analysis.check.power_analysis import CostEstimate
from avrare.base.number_format import format_duration
from avrare.output.documents import format_numbers, list_notes
from avrare.output.terminal.console import (
    VERDICT_COLOURS,
    Mode,
    colour_verdict,
    make_console,
    make_table,
    print_table,
)


def print_check(outcome: CheckResult, mode: Mode = "auto") -> None:
    """Print the verdicts; in quiet mode one line each and the overall verdict."""
    console = make_console(mode)
    if mode == "quiet":
        for line in outcome.lines():
            console.print(line, markup=False)
        return
    print_table(console, _verdict_table(outcome))
    reasons: dict[tuple[str, str, str], list[str]] = {}
    for decision in outcome.decisions:
        reasons.setdefault((decision.scenario, decision.verdict, decision.reason), []).append(decision.name)
    for (scenario, verdict, reason), names in reasons.items():
        if reason:
            text = f"{scenario}  {', '.join(names)}: {reason}"
            console.print(text, style=VERDICT_COLOURS[verdict], markup=False)
    for decision in outcome.decisions:
        if decision.next_step:
            console.print(f"{decision.scenario}  {decision.name}: {decision.next_step}", markup=False)
    for note in (*outcome.notes, *list_notes(outcome)):
        console.print(note, markup=False)
    console.print(f"{colour_verdict(outcome.verdict)}{outcome.details}")


def _verdict_table(outcome: CheckResult) -> Table:
    several = len(outcome.results) > 1
    compared = any(decision.change_interval for decision in outcome.decisions)
    table = make_table(
        "check  " + ", ".join(outcome.results),
        [*(["scenario"] if several else []), "specification", "required"],
        ["probability", "interval", *(["baseline", "change"] if compared else [])],
    )
    table.add_column("verdict", no_wrap=True)
    for decision in outcome.decisions:
        cells = [*([decision.scenario] if several else []), decision.specification, decision.question]
        numbers = list(format_numbers(decision).values())
        cells += numbers if compared else numbers[:2]
        table.add_row(*map(escape, cells), colour_verdict(decision.verdict))
    return table


def print_plan(costs: Sequence[CostEstimate], mode: Mode = "auto") -> None:
    """Print the predicted costs of verdicts."""
    console = make_console(mode)
    console.width = max(console.width, 100)  # columns that a plan needs; a narrower terminal wraps its lines
    texts, numbers = ("scenario", "specification", "required"), ("rollouts", "steps", "time")
    table = make_table("predicted cost of a verdict", texts, numbers)
    table.add_column("reason")
    for plan in costs:
        cost = ["-"] * 3
        if plan.rollouts is not None:
            cost = [f"{plan.rollouts:,}", f"{plan.steps:,}", format_duration(plan.seconds)]
        table.add_row(*map(escape, [plan.scenario, plan.specification, plan.question, *cost, plan.reason]))
    console.print(table)
