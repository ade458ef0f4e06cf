"""Live line of a running estimate, in a terminal or a notebook, and the table of its results."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from html import escape

from avrare.base.number_format import format_typeset, format_typeset_interval
from avrare.estimation.plan.plan import Info
from avrare.estimation.result.result import Column, Result, choose_columns
from avrare.output.terminal.progress_line import Progress
from avrare.rollout.problem import Problem


@contextmanager
def show_progress(
    label: str, problem: Problem, confidence: float | None
) -> Iterator[Progress | _NotebookLine]:
    """Show the progress of an estimate until the context ends; gives the function that gets each ``Info``."""
    line = Progress(label, problem, "auto", confidence)
    if not _in_notebook():
        with line:
            yield line
        return
    display = _NotebookLine(line)
    yield display
    display.close()


def _in_notebook() -> bool:
    shell = sys.modules.get("IPython") and sys.modules["IPython"].get_ipython()
    return shell is not None and hasattr(shell, "kernel")


class _NotebookLine:
    def __init__(self, line: Progress) -> None:
        from IPython.display import display

        self.line, self.shown = line, time.monotonic()
        self.handle = display({"text/plain": line.label}, raw=True, display_id=True)

    def __call__(self, info: Info) -> None:
        self.line.see(info)
        now = time.monotonic()
        if now - self.shown >= 0.25:
            self.shown = now
            self._show(self.line.line(info, now - self.line.began))

    def close(self) -> None:
        """Show the last state."""
        self._show(self.line.line(self.line.info, time.monotonic() - self.line.began))

    def _show(self, text: str) -> None:
        if self.handle is not None:
            self.handle.update({"text/plain": text}, raw=True)


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
