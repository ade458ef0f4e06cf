"""Table of the estimates of a run, and the lines below it."""

from __future__ import annotations

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from avrare.base.number_format import format_estimate, format_interval, format_probability
from avrare.estimation.result.result import Result, choose_columns
from avrare.output.terminal.console import colour_verdict, make_table


def result_table(title: str, results: Sequence[Result]) -> Table:
    """Return one row per specification; verdicts take the place of seconds, to fit into 80 columns."""
    verdicts = any(result.verdict for result in results)
    columns = choose_columns(results)
    numbers = ["probability", "interval", *(column.name for column in columns)]
    table = make_table(title, ["specification"], numbers if verdicts else [*numbers, "seconds"])
    if verdicts:
        table.add_column("verdict", no_wrap=True)
    for result in results:
        table.add_row(
            escape(result.specification),
            format_probability(result.probability),
            format_interval(result.interval),
            *(str(column.count(result)) for column in columns),
            colour_verdict(result.verdict) if verdicts else f"{result.seconds:.1f}",
        )
    return table


def verdict_lines(name: str, results: Sequence[Result]) -> list[str]:
    """Return ``lane_change safe_distance: pass, 0.0123 (0.01 .. 0.02), few_roots`` for each specification."""
    return [
        f"{name} {result.specification}: {result.verdict or 'no threshold'}, "
        + ", ".join([format_estimate(result.probability, result.interval), *result.health])
        for result in results
    ]


def warning_lines(results: Sequence[Result]) -> list[str]:
    """Return the health warnings of all results; each line once."""
    return _name_specifications(
        results, [[f"warning {name}: {text}" for name, text in result.health.items()] for result in results]
    )


def note_lines(results: Sequence[Result]) -> list[str]:
    """Return the notes of all results; each line once."""
    return _name_specifications(results, [[note.text for note in result.notes] for result in results])


def _name_specifications(results: Sequence[Result], texts: Sequence[Sequence[str]]) -> list[str]:
    names: dict[str, list[str]] = {}
    for result, lines in zip(results, texts, strict=True):
        for text in lines:
            names.setdefault(text, []).append(result.specification)
    return [
        text if len(said) == len(results) else f"{', '.join(said)}: {text}" for text, said in names.items()
    ]
