"""Table of the estimates of a run, and the notes below it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.markup import escape
from rich.table import Table

from avrare.base.number_format import (
    describe_blind_bound,
    describe_stop,
    format_interval,
    format_probability,
)
from avrare.estimation.result import Result
from avrare.report.terminal.console import colour_verdict, make_table


def result_table(title: str, results: Sequence[Result]) -> Table:
    """Return one row per specification; verdicts take the place of seconds, to fit into 80 columns."""
    verdicts = any(result.verdict for result in results)
    errors = any(result.errors for result in results)
    numbers = ["probability", "interval", "rollouts", "failures", *(["errors"] if errors else [])]
    table = make_table(title, ["specification"], numbers if verdicts else [*numbers, "seconds"])
    if verdicts:
        table.add_column("verdict", no_wrap=True)
    for result in results:
        table.add_row(
            escape(result.specification), format_probability(result.probability),
            format_interval(result.interval), str(result.rollouts), str(result.failures.count),
            *([str(result.errors)] if errors else []),
            colour_verdict(result.verdict) if verdicts else f"{result.seconds:.1f}",
        )  # fmt: skip
    return table


def verdict_lines(name: str, results: Sequence[Result]) -> list[str]:
    """Return ``lane_change safe_distance: pass, 0.0123 (0.01 .. 0.02), few_roots`` for each specification."""
    return [
        f"{name} {one.specification}: {one.verdict or 'no threshold'}, "
        f"{format_probability(one.probability)} ({format_interval(one.interval)})"
        + "".join(f", {warning}" for warning in one.health)
        for one in results
    ]


def note_lines(results: Sequence[Result]) -> list[str]:
    """Return the warnings and the non-zero counters of all results; each line once."""
    lines: dict[str, list[str]] = {}
    for result in results:
        for name, message in result.health.items():
            lines.setdefault(f"warning {name}: {message}", []).append(result.specification)
        if result.diagnostics.get("goal_reached") is False:
            text = result.diagnostics.get("ended_early") or _describe_end(result)
            lines.setdefault(text, []).append(result.specification)
        elif "used_rollouts" in result.diagnostics and result.diagnostics["used_rollouts"] < result.rollouts:
            text = describe_stop(result.diagnostics["used_rollouts"], result.failures.count)
            lines.setdefault(text, []).append(result.specification)
        if note := result.diagnostics.get("note"):
            lines.setdefault(note, []).append(result.specification)
        counts = {name: n for name, n in result.counts.items() if n and name != "solves"}
        total = f" of {result.counts['solves']} solves" if "solves" in result.counts else ""
        for of_solver in (True, False):
            shown = [(name, n) for name, n in counts.items() if ("solve" in name) == of_solver]
            if shown:
                text = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in shown)
                lines.setdefault(text + total * of_solver, []).append(result.specification)
    return _name_specifications(lines, results)


def _describe_end(result: Result) -> str:
    """Return why an estimate ended short of its goal, and what to do."""
    in_runs = "looks" in result.diagnostics
    if "used_rollouts" in result.diagnostics:  # Monte Carlo stops at a number of failures
        found = f"with {result.failures.count} failures"
    elif not result.probability:
        found = "without reaching a failure"
    else:
        found = f"at a relative error of {result.relative_error:.0%}"
    more = f"raise `{'most_runs' if in_runs else 'rollouts'}` of the estimator, or the budget"
    return f"the run ended after {result.rollouts} rollouts, {found}, before it reached its goal: {more}"


def blind_lines(results: Sequence[Result]) -> list[str]:
    """Return what the results say of failures that their score does not lead to; each line once."""
    lines: dict[str, list[str]] = {}
    for result in results:
        if result.blind_bound is not None:
            lines.setdefault(describe_blind_bound(result.blind_bound), []).append(result.specification)
    return _name_specifications(lines, results)


def choice_lines(results: Sequence[Result]) -> list[str]:
    """Return which estimator was chosen for each result, why, and at what cost; each line once."""
    lines: dict[str, list[str]] = {}
    for result in results:
        if choice := result.diagnostics.get("choice"):
            lines.setdefault(choice["text"], []).append(result.specification)
    return _name_specifications(lines, results)


def model_lines(results: Sequence[Result]) -> list[str]:
    """Return how much of the uncertainty is the model's, where an ensemble was given; each line once."""
    lines: dict[str, list[str]] = {}
    for result in results:
        if model := result.diagnostics.get("model"):
            lines.setdefault(model["text"], []).append(result.specification)
    return _name_specifications(lines, results)


def learnt_lines(results: Sequence[Result]) -> list[str]:
    """Return what the estimator has learnt of the failures; each line once."""
    lines: dict[str, list[str]] = {}
    for result in results:
        for cause in result.diagnostics.get("learnt", ()):
            lines.setdefault(cause["text"], []).append(result.specification)
    return _name_specifications(lines, results)


def check_lines(results: Sequence[Result]) -> list[str]:
    """Return one line for each cross-check."""
    checks = {result.specification: result.cross_check for result in results if result.cross_check}
    return [
        f"{f'{name}: ' if len(results) > 1 else ''}{one.text} ({one.rollouts} rollouts, {one.seconds:.1f} s)"
        for name, one in checks.items()
    ]


def _name_specifications(lines: Mapping[str, list[str]], results: Sequence[Result]) -> list[str]:
    return [
        text if len(names) == len(results) else f"{', '.join(names)}: {text}" for text, names in lines.items()
    ]
