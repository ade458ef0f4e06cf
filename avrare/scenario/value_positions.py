"""Plain data with the place where each value was written, for messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from avrare.base.errors import ScenarioError

Path: TypeAlias = tuple[str | int, ...]
Scalar: TypeAlias = bool | int | float | str | None


@dataclass(frozen=True, order=True)
class Mark:
    """Place in a file (line and column count from 1) or, with line 0, a command-line option."""

    file: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{printable(self.file)}:{self.line}:{self.column}" if self.line else printable(self.file)

    def error(self, text: str, hint: str | None = None) -> ScenarioError:
        """Return the error with this message about the place."""
        return ScenarioError([(f"{self}: {text}", hint)])


@dataclass(frozen=True)
class Node:
    """Value with its place.

    Attributes:
        value: A scalar, a list of nodes, or a mapping from strings to nodes.
        mark: Place of the value.
        key: Place of its key; None for list items and the top of a file.
    """

    value: Scalar | list[Node] | dict[str, Node]
    mark: Mark
    key: Mark | None = None

    @classmethod
    def of(cls, data: Any, mark: Mark) -> Node:
        """Return plain data as nodes that all stand at ``mark``; values of other types become scalars."""
        if isinstance(data, dict):
            return cls({key: cls.of(item, mark) for key, item in data.items()}, mark, mark)
        return cls([cls.of(item, mark) for item in data] if isinstance(data, list) else data, mark, mark)

    @property
    def name_mark(self) -> Mark:
        """Place of the key, or of the value where there is no key."""
        return self.key or self.mark

    @property
    def entries(self) -> dict[str, Node]:
        """Entries of a mapping; empty for any other value."""
        return self.value if isinstance(self.value, dict) else {}

    @property
    def items(self) -> list[Node]:
        """Items of a list; empty for any other value."""
        return self.value if isinstance(self.value, list) else []

    def entries_at(self, key: str) -> dict[str, Node]:
        """Return the entries of the mapping ``key``; empty if there is none."""
        node = self.entries.get(key)
        return node.entries if node else {}

    def plain(self) -> Any:
        """Return the value without places."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.plain() for node in self.value]
        return self.value

    def child(self, step: str | int) -> Node | None:
        """Return the entry or item ``step``, or None."""
        if isinstance(step, str):
            return self.entries.get(step)
        return self.items[step] if 0 <= step < len(self.items) else None


def dotted(path: Sequence[str | int]) -> str:
    """Return a path as ``thresholds.0.confidence``; keys that would break the line are quoted."""
    return ".".join(printable(str(step)) for step in path)


def printable(text: str) -> str:
    """Return the text, quoted if it is empty or would break the line."""
    return text if text and text.isprintable() else repr(text)
