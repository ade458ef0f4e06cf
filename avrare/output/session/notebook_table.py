"""Table of results for notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from avrare.base.number_format import format_typeset, format_typeset_interval
from avrare.estimation.result.result import Result

_COLUMNS = ("specification", "probability", "interval", "estimator", "rollouts", "failures", "verdict")


def render_table(results: Sequence[Result]) -> str:
    """Return an HTML table with the warnings and notes below it."""
    head = "".join(f"<th>{name}</th>" for name in _COLUMNS if name != "verdict" or _judged(results))
    rows = "".join(f"<tr>{_row(one, _judged(results))}</tr>" for one in results)
    texts = [(one, f"{name}: {text}") for one in results for name, text in one.health.items()]
    texts += [(one, note.text) for one in results for note in one.notes]
    lines = "".join(f"<li><b>{escape(one.specification)}</b> {escape(text)}</li>" for one, text in texts)
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    return table + (f"<ul>{lines}</ul>" if lines else "")


def _judged(results: Sequence[Result]) -> bool:
    return any(one.verdict for one in results)


def _row(result: Result, judged: bool) -> str:
    cells = [
        result.specification,
        format_typeset(result.probability),
        format_typeset_interval(result.interval),
        result.estimator,
        f"{result.rollouts:,}",
        f"{result.failures.count:,}",
        *([result.verdict or "–"] if judged else []),
    ]
    return "".join(f"<td>{escape(cell)}</td>" for cell in cells)
