"""Warnings as commands print them."""

from __future__ import annotations

import sys
from collections.abc import Iterable


def warn(doubts: Iterable[tuple[str, str | None]]) -> None:
    """Print (message, hint) pairs on stderr, each of them once.

    Args:
        doubts: Such as ``Scenario.warnings``.
    """
    for message, hint in dict.fromkeys(doubts):
        print(f"warning: {message}" + (f"\nhint: {hint}" if hint else ""), file=sys.stderr)
