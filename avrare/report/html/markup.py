"""HTML made of nested calls: whatever is not markup already is escaped."""

from __future__ import annotations

import json
from collections.abc import Iterable
from html import escape
from typing import Any

_VOID = frozenset({"br", "hr", "img", "input", "meta", "line", "path", "rect", "wbr"})


class Markup(str):
    """Text that is HTML."""

    __slots__ = ()


def tag(name: str, /, *children: Any, **attributes: Any) -> Markup:
    """An element.

    Args:
        name: Of the element.
        children: Markup, text (escaped), None (left out), or iterables of these.
        attributes: ``class_`` is ``class``, ``aria_label`` is ``aria-label``; True is a bare attribute, None
            and False are left out.
    """
    written = "".join(_attribute(key, value) for key, value in attributes.items())
    if name in _VOID:
        return Markup(f"<{name}{written}>" if name not in ("line", "path", "rect") else f"<{name}{written}/>")
    return Markup(f"<{name}{written}>{join(children)}</{name}>")


def join(children: Iterable[Any]) -> Markup:
    """Children of ``tag`` one after another."""
    return Markup("".join(map(_child, children)))


def data(content: Any) -> Markup:
    """A block of JSON for a script to read; no text in it can end the block."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return Markup(f'<script type="application/json">{text.replace("<", chr(92) + "u003c")}</script>')


def _attribute(key: str, value: Any) -> str:
    if value is None or value is False:
        return ""
    name = key.rstrip("_").replace("_", "-")
    return f" {name}" if value is True else f' {name}="{escape(str(value))}"'


def _child(child: Any) -> str:
    if child is None:
        return ""
    if isinstance(child, Markup):
        return child
    if isinstance(child, (str, int, float)):
        return escape(str(child))
    return join(child)
