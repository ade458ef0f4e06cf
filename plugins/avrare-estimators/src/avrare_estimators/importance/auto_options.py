"""Options with which ``auto`` tries ``is``."""

from __future__ import annotations

_LEAST_PILOT = 200
_MOST_STAGES = 20
"""A small pilot climbs slowly; learning takes at most half of the rollouts anyway."""
_CHECK_SHARE = 0.3
"""Share of the cross-check where no error is to be reached that would say what it takes: the samples are
small, and with less it often falls short."""


def choose_options(relative_error: float | None, pilot: int) -> dict[str, object]:
    """Return the options of a learned proposal that gives up where it gains nothing."""
    options = {"pilot": max(_LEAST_PILOT, pilot), "stages": _MOST_STAGES, "fall_back": False}
    return options | ({"check": _CHECK_SHARE} if relative_error is None else {})
