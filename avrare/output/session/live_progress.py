"""Live line of a running estimate, in a terminal or a notebook."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from avrare.estimation.plan.plan import Info
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
