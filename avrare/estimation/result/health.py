"""Health warnings of an estimate, by name."""

from __future__ import annotations

from collections.abc import Sequence

from avrare.base.health_messages import MESSAGES, fill


def warn(name: str, **values: object) -> dict[str, str]:
    """Return one of the core's warnings with its text filled in."""
    return fill(MESSAGES, name, **values)


def check_errors(errors: int, rollouts: int, allowed: float, messages: Sequence[str]) -> dict[str, str]:
    """Return a warning when more than the allowed share of rollouts ended in an error."""
    if errors <= allowed * rollouts:
        return {}
    causes = "; ".join(list(dict.fromkeys(messages))[:2]) or "?"
    return warn("errors", errors=errors, rollouts=rollouts, allowed=allowed, message=causes)
