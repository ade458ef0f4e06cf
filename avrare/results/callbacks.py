"""Callbacks of installed distributions, called with each run folder that has been written."""

from __future__ import annotations

import os
from importlib.metadata import EntryPoint, entry_points

from avrare.plugin.registry import VARIABLE
from avrare.results.run import Run

GROUP = "avrare.results"
"""Entry points whose value is a function ``on_result(run: Run) -> str | None``."""


def call_back(run: Run) -> list[str]:
    """Call the callbacks of all installed distributions with a run that has been written.

    An exception becomes a line, and changes no exit code.

    Returns:
        Lines to show: the callbacks' texts, and the callbacks that failed.
    """
    lines = []
    for point in _find_allowed():
        try:
            said = point.load()(run)
        except (Exception, SystemExit) as error:
            lines.append(f"callback {point.name} failed: {type(error).__name__}: {error}")
        else:
            lines += [str(said)] if said else []
    return lines


def _find_allowed() -> list[EntryPoint]:
    names = os.environ.get(VARIABLE)
    allowed = None if names is None else {name.strip() for name in names.split(",")}
    points = sorted(entry_points(group=GROUP), key=lambda point: point.name)
    return [point for point in points if allowed is None or point.name in allowed]
