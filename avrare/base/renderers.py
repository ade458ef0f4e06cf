"""Table of the functions that draw and write values; the top room fills it.

So a result has ``plot()`` and ``report()``, and its module imports neither.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

Renderer = Callable[..., Any]
_TABLE: dict[str, Renderer] = {}


def fill(renderers: Iterable[Renderer]) -> None:
    """Enter functions under their names."""
    _TABLE.update({renderer.__name__: renderer for renderer in renderers})


def render(name: str, *arguments: object) -> Any:
    """Call the function that the top room has entered under a name."""
    return _TABLE[name](*arguments)
