"""HTML from nested function calls: everything that is not markup already is escaped."""

from __future__ import annotations

import json
from collections.abc import Iterable
from html import escape
from typing import Any

from avrare.base.visible_text import spell_controls

_VOID = frozenset({"br", "hr", "img", "input", "meta", "line", "path", "rect", "wbr"})


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def tag(name: str, /, *children: Any, **attributes: Any) -> Markup:
    """Return an element; children are markup, text (escaped), None (omitted), or iterables of these.

    The attribute ``class_`` stands for ``class``, ``aria_label`` for ``aria-label``; True gives a bare
    attribute, None and False are omitted.
    """
    written = "".join(_format_attribute(key, value) for key, value in attributes.items())
    if name in _VOID:
        return Markup(f"<{name}{written}>" if name not in ("line", "path", "rect") else f"<{name}{written}/>")
    return Markup(f"<{name}{written}>{join(children)}</{name}>")


def join(children: Iterable[Any]) -> Markup:
    """Concatenate children, as ``tag`` takes them."""
    return Markup("".join(map(_format_child, children)))


def json_block(content: Any) -> Markup:
    """Return a block of JSON for a script; no text in it can end the block."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return Markup(f'<script type="application/json">{text.replace("<", chr(92) + "u003c")}</script>')


def _escape(value: Any) -> str:
    return escape(spell_controls(str(value)))


def _format_attribute(key: str, value: Any) -> str:
    if value is None or value is False:
        return ""
    name = key.rstrip("_").replace("_", "-")
    return f" {name}" if value is True else f' {name}="{_escape(value)}"'


def _format_child(child: Any) -> str:
    if child is None:
        return ""
    if isinstance(child, Markup):
        return child
    return _escape(child) if isinstance(child, (str, int, float)) else join(child)


def link_command(name: str) -> Markup:
    """Return a link to the command, at the end of a report, that makes the numbers beside it."""
    return tag("a", "command", href=f"#command-{name}", class_="how")
