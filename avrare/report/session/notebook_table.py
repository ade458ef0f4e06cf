"""Table of results for notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from avrare.base.number_format import (
    describe_blind_bound,
    format_typeset,
    format_typeset_interval,
)
from avrare.estimation.result import Result

_COLUMNS = ("specification", "probability", "interval", "estimator", "rollouts", "failures", "verdict")


def render_results(results: Sequence[Result]) -> str:
    """Return an HTML table with the warnings and bounds below it."""
    head = "".join(f"<th>{name}</th>" for name in _COLUMNS if name != "verdict" or _judged(results))
    rows = "".join(f"<tr>{_row(one, _judged(results))}</tr>" for one in results)
    notes = [_note(one, f"{name}: {text}") for one in results for name, text in one.health.items()]
    notes += [_note(one, one.diagnostics["choice"]["text"]) for one in results if "choice" in one.diagnostics]
    notes += [_note(one, describe_blind_bound(one.blind_bound)) for one in results if one.blind_bound]
    notes += [_note(one, one.cross_check.text) for one in results if one.cross_check]
    lines = "".join(f"<li>{note}</li>" for note in notes)
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    return table + (f"<ul>{lines}</ul>" if lines else "")


def _judged(results: Sequence[Result]) -> bool:
    return any(one.verdict for one in results)


def _row(result: Result, judged: bool) -> str:
    cells = [
        result.specification, format_typeset(result.probability), format_typeset_interval(result.interval),
        result.estimator, f"{result.rollouts:,}", f"{result.failures.count:,}",
        *([result.verdict or "–"] if judged else []),
    ]  # fmt: skip
    return "".join(f"<td>{escape(cell)}</td>" for cell in cells)


def _note(result: Result, text: str) -> str:
    return f"<b>{escape(result.specification)}</b> {escape(text)}"
