"""Plain data that remembers where it was written, so that any later complaint can name the place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

Path: TypeAlias = tuple[str | int, ...]
Scalar: TypeAlias = bool | int | float | str | None


@dataclass(frozen=True, order=True)
class Mark:
    """A place: in a file (line and column count from 1) or, with line 0, a command-line option."""

    file: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{shown(self.file)}:{self.line}:{self.column}" if self.line else shown(self.file)


@dataclass(frozen=True)
class Node:
    """A value with its place.

    Attributes:
        value: A scalar, a list of nodes, or a mapping from strings to nodes.
        mark: Where the value begins.
        key: Where its key begins; None for list items and the top of a file.
    """

    value: Scalar | list[Node] | dict[str, Node]
    mark: Mark
    key: Mark | None = None

    @property
    def name_mark(self) -> Mark:
        """The place of the key, or of the value where there is none."""
        return self.key or self.mark

    @property
    def entries(self) -> dict[str, Node]:
        """The entries of a mapping; empty for everything else."""
        return self.value if isinstance(self.value, dict) else {}

    def plain(self) -> Any:
        """The value without its places."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.plain() for node in self.value]
        return self.value

    def child(self, step: str | int) -> Node | None:
        """The entry or item ``step``, or None."""
        if isinstance(self.value, dict):
            return self.value.get(step) if isinstance(step, str) else None
        if isinstance(self.value, list) and isinstance(step, int) and 0 <= step < len(self.value):
            return self.value[step]
        return None


def dotted(path: Sequence[str | int]) -> str:
    """``thresholds.0.confidence``; keys that would garble the line are quoted."""
    return ".".join(shown(str(step)) for step in path)


def shown(text: str) -> str:
    """The text itself, or quoted where it is empty or would break the line."""
    return text if text and text.isprintable() else repr(text)
