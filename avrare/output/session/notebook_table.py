"""Table of results for notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from avrare.base.number_format import format_typeset, format_typeset_interval
from avrare.estimation.result.result import Column, Result, choose_columns


def render_table(results: Sequence[Result]) -> str:
    """Return an HTML table with the warnings and notes below it."""
    columns, judged = choose_columns(results), any(result.verdict for result in results)
    names = ["specification", "probability", "interval", "estimator", *(column.name for column in columns)]
    head = "".join(f"<th>{name}</th>" for name in [*names, *(["verdict"] if judged else [])])
    rows = "".join(f"<tr>{_row(result, columns, judged)}</tr>" for result in results)
    texts = [(result, f"{name}: {text}") for result in results for name, text in result.health.items()]
    texts += [(result, note.text) for result in results for note in result.notes]
    lines = "".join(
        f"<li><b>{escape(result.specification)}</b> {escape(text)}</li>" for result, text in texts
    )
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    return table + (f"<ul>{lines}</ul>" if lines else "")


def _row(result: Result, columns: Sequence[Column], judged: bool) -> str:
    cells = [
        result.specification,
        format_typeset(result.probability),
        format_typeset_interval(result.interval),
        result.estimator,
        *(f"{column.count(result):,}" for column in columns),
        *([result.verdict or "–"] if judged else []),
    ]
    return "".join(f"<td>{escape(cell)}</td>" for cell in cells)
