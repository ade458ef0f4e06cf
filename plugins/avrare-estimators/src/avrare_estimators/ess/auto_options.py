"""Options with which ``auto`` tries ``ess``."""

from __future__ import annotations

from avrare_estimators.common.config import LEAST_RUNS_OF_LOOK


def choose_options(relative_error: float | None, pilot: int) -> dict[str, object]:
    """Return the options of few runs, which a budget lets grow."""
    return {"runs": LEAST_RUNS_OF_LOOK} if relative_error else {}
