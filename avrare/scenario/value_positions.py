"""Tree of plain data that knows where each value was written; trees are merged, and values put into them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from avrare.base.errors import ScenarioError, did_you_mean

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
            return cls({key: cls.of(element, mark) for key, element in data.items()}, mark, mark)
        return cls(
            [cls.of(element, mark) for element in data] if isinstance(data, list) else data, mark, mark
        )

    @property
    def name_mark(self) -> Mark:
        """Place of the key, or of the value without a key."""
        return self.key or self.mark

    @property
    def entries(self) -> dict[str, Node]:
        """Entries of a mapping; empty for any other value."""
        return self.value if isinstance(self.value, dict) else {}

    @property
    def items(self) -> list[Node]:
        """Items of a list; empty for any other value."""
        return self.value if isinstance(self.value, list) else []

    @property
    def children(self) -> list[tuple[str | int, Node]]:
        """Keys and entries of a mapping, or places and items of a list."""
        return [*self.entries.items(), *enumerate(self.items)]

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

    def without(self, keys: Collection[str]) -> Node:
        """Return a mapping without some of its keys; any other value as it is."""
        if not isinstance(self.value, dict):
            return self
        return Node({key: node for key, node in self.value.items() if key not in keys}, self.mark, self.key)

    def replace(self, path: Path, value: Scalar) -> Node:
        """Return the same tree with another value at an existing place."""
        if not path:
            return Node(value, self.mark, self.key)
        step, rest = path[0], path[1:]
        if isinstance(self.value, list):
            items = [node.replace(rest, value) if k == step else node for k, node in enumerate(self.value)]
            return Node(items, self.mark, self.key)
        entries = {
            key: node.replace(rest, value) if key == step else node for key, node in self.entries.items()
        }
        return Node(entries, self.mark, self.key)


def merge(base: Node, over: Node) -> Node:
    """Merge ``over`` into ``base``: mappings recursively, everything else replaced.

    A null in ``over`` removes the inherited key. A component block that names another plugin, or a formula
    in place of a plugin, replaces the block: the options of one plugin mean nothing to another.
    """
    if not isinstance(base.value, dict) or not isinstance(over.value, dict):
        return over
    chosen, inherited = _component(over), _component(base)
    if chosen and inherited and chosen != inherited:
        return over
    entries = dict(base.value)
    for key, node in over.value.items():
        if key not in entries:
            entries[key] = node
        elif node.value is None:
            del entries[key]
        else:
            entries[key] = merge(entries[key], node)
    return Node(entries, over.mark, over.key)


def _component(node: Node) -> tuple[str, ...]:
    if "stl" in node.entries:
        return ("stl",)
    plugin = node.entries.get("plugin")
    return ("plugin", str(plugin.value)) if plugin else ()


def put(node: Node, path: Path, value: Node, mark: Mark) -> Node:
    """Return the tree with another value at a path; ``mark`` is the place of the request."""
    if not path:
        return value
    step, rest = str(path[0]), path[1:]
    if isinstance(node.value, list):
        index = _index(node.value, step, mark)
        items = list(node.value)
        items[index] = put(items[index], rest, value, mark)
        return Node(items, node.mark, node.key)
    if node.value is not None and not isinstance(node.value, dict):
        raise mark.error(f"{node.value!r} has nothing named {step!r}", "shorten the path")
    entries = node.entries
    if step == "plugin" and not rest and step in entries and entries[step].value != value.value:
        entries = {}  # the options of one plugin mean nothing to another
    changed = put(entries.get(step, Node({}, mark, mark)), rest, value, mark)
    return Node({**entries, step: changed}, node.mark, node.key)


def _index(items: list[Node], step: str, mark: Mark) -> int:
    if step.isascii() and step.isdigit() and len(step) < 9 and int(step) < len(items):
        return int(step)
    indices = [str(i) for i in range(len(items))]
    raise mark.error(f"the list has no item {step!r}", did_you_mean(step, indices) or "it is empty")


def join_path(path: Sequence[str | int]) -> str:
    """Return a path as ``thresholds.0.confidence``; keys that would break the line are quoted."""
    return ".".join(printable(str(step)) for step in path)


def printable(text: str) -> str:
    """Return the text, quoted if it is empty or would break the line."""
    return text if text and text.isprintable() else repr(text)
