"""Reading of drawn options: a law in the place of a number, as the YAML file has it.

The model of the plugin sees the median of every law. That its draws keep the model's bounds is checked far
out in either tail of each law, one law at a time.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel

from avrare.base.csv_table import read_csv_table
from avrare.base.errors import UsageError, did_you_mean
from avrare.base.laws import LAWS, condense
from avrare.plugin.drawable import is_drawable
from avrare.scenario.draws import KEY, Draws, DrawSettings, correlation_matrix
from avrare.scenario.safe_mode import refuse_outside
from avrare.scenario.validation import Mistake, check, describe, fields_at
from avrare.scenario.value_positions import Node, Path

TAIL = 6.0
"""Normal score at which draws are checked against the bounds of their option: 1e-9 lies beyond."""


def find_draws(
    model: type[BaseModel], node: Node, path: Path, folder: str
) -> tuple[Node, Draws | None, list[Mistake]]:
    """Return a block with medians in place of laws and without its settings, and what is drawn.

    Args:
        model: Model of the simulator's options.
        node: The simulator's block as written.
        path: Keys that lead to it.
        folder: Folder of the scenario, which safe mode does not leave.
    """
    laws: dict[Path, tuple[Any, Node]] = {}
    mistakes: list[Mistake] = []
    for at, written in _laws_in(node, ()):
        fields = fields_at(model, at)
        if any(is_drawable(field) for field in fields):
            law, found = _read_law(written, (*path, *at), folder)
            mistakes += found
            laws |= {at: (law, written)} if law is not None else {}
        elif any(_is_number(field.annotation) for field in fields):
            mistakes.append(_not_drawable(model, node, written, (*path, *at)))
    settings_node = node.child(KEY)
    if not laws and not mistakes and settings_node is None:
        return node, None, []
    # Sorted, so that the order in which a file names its options is of no account.
    laws = dict(sorted(laws.items(), key=lambda item: [str(step) for step in item[0]]))
    names = tuple(_name(node, at) for at in laws)
    settings, found = _read_settings(settings_node, (*path, KEY), names, bool(mistakes))
    mistakes += found
    plain = _replace(node, {at: float(law.at(0.0)) for at, (law, _) in laws.items()})
    plain = Node({k: v for k, v in plain.entries.items() if k != KEY}, node.mark, node.key)
    if not mistakes:
        mistakes = _check_tails(model, plain, path, laws)
    paths = tuple(".".join(map(str, at)) for at in laws)
    draws = Draws(paths, names, tuple(law for law, _ in laws.values()), settings or DrawSettings())
    return plain, (draws if laws and not mistakes else None), mistakes


def _laws_in(node: Node, path: Path) -> Iterator[tuple[Path, Node]]:
    if "law" in node.entries and path:
        yield path, node
        return
    steps: list[tuple[str | int, Node]] = [*node.entries.items(), *enumerate(node.items)]
    for step, child in steps:
        if path or step != KEY:
            yield from _laws_in(child, (*path, step))


def _is_number(annotation: Any) -> bool:
    arguments = getattr(annotation, "__args__", ())
    return annotation in (int, float) or any(_is_number(one) for one in arguments)


def _not_drawable(model: type[BaseModel], node: Node, written: Node, path: Path) -> Mistake:
    known = [
        ".".join(map(str, at)) for at in _places(node, ()) if any(map(is_drawable, fields_at(model, at)))
    ]
    hint = f"of the options given here these can: {', '.join(known)}" if known else None
    return Mistake(written.mark, path, "this option cannot be drawn: it should be a number", hint)


def _places(node: Node, path: Path) -> Iterator[Path]:
    steps: list[tuple[str | int, Node]] = [*node.entries.items(), *enumerate(node.items)]
    for step, child in steps:
        yield (*path, step)
        if "law" not in child.entries:
            yield from _places(child, (*path, step))


def _read_law(node: Node, path: Path, folder: str) -> tuple[Any, list[Mistake]]:
    name = node.entries["law"]
    if not isinstance(name.value, str) or name.value not in LAWS:
        text = f"should be one of {', '.join(LAWS)}, found {describe(name)}"
        return None, [Mistake(name.mark, (*path, "law"), text, did_you_mean(str(name.value), LAWS))]
    try:
        node = _with_columns(node, folder)
    except UsageError as error:
        return None, [Mistake(node.mark, path, error.message, error.hint)]
    return check(LAWS[str(name.value)], node, path)


def _with_columns(node: Node, folder: str) -> Node:
    # Columns of CSV files become the values themselves: a run is then complete without the file.
    entries = {key: _with_columns(child, folder) for key, child in node.entries.items()}
    items = [_with_columns(child, folder) for child in node.items]
    if entries.get("law", node).value != "empirical" or "file" not in entries:
        return Node(entries or items or node.value, node.mark, node.key)
    if "values" in entries:
        raise UsageError("give values or a file, not both")
    file, column = str(entries.pop("file").value), entries.pop("column", None)
    beside = os.path.dirname(node.mark.file) if node.mark.line else folder
    name = os.path.normpath(os.path.join(beside, file))
    refuse_outside(name, folder, "empirical law: file")
    table = read_csv_table(name)
    table.check_rows()
    if column is None or str(column.value) not in table.names:
        word = "" if column is None else str(column.value)
        text = f"{file} has no column {word!r}" if word else "give the column of the file"
        raise UsageError(text, did_you_mean(word, table.names))
    found = [table.finite(row, str(column.value)) for row in range(len(table.rows))]
    return Node(
        {**entries, "values": Node.of(condense(np.array(found)).tolist(), node.mark)}, node.mark, node.key
    )


def _name(node: Node, path: Path) -> str:
    words = []
    for step in path:
        child = node.child(step)
        named = child.entries.get("name") if child is not None and isinstance(step, int) else None
        words.append(str(named.value if named is not None else step))
        node = child or node
    return ".".join(words)


def _read_settings(
    node: Node | None, path: Path, names: Sequence[str], silent: bool
) -> tuple[DrawSettings | None, list[Mistake]]:
    if node is None:
        return None, []
    if not isinstance(node.value, dict):
        return None, [Mistake(node.mark, path, f"should be a mapping, found {describe(node)}")]
    settings, mistakes = check(DrawSettings, node, path)
    if settings is None or silent:
        return None, mistakes
    if not names:
        hint = "write a law in place of a number, such as {law: normal, mean: 20.0, sd: 1.0}"
        return None, [Mistake(node.name_mark, path, "no option of this simulator is drawn", hint)]
    mistakes = _check_pairs(node.entries.get("correlations", node), (*path, "correlations"), names)
    if not mistakes and np.linalg.eigvalsh(correlation_matrix(names, settings.correlations)).min() < -1e-9:
        text, hint = "these correlations contradict each other", "bring them nearer to 0, or leave one out"
        mistakes = [Mistake(node.entries["correlations"].name_mark, (*path, "correlations"), text, hint)]
    return settings, mistakes


def _check_pairs(pairs: Node, path: Path, names: Sequence[str]) -> list[Mistake]:
    mistakes = []
    for index, item in enumerate(pairs.items):
        ends = item.entries["between"].items
        for place, end in enumerate(ends):
            if end.value not in names:
                text, hint = f"no drawn option is called {end.value!r}", did_you_mean(str(end.value), names)
                mistakes.append(Mistake(end.mark, (*path, index, "between", place), text, hint))
        if ends[0].value == ends[1].value:
            mistakes.append(Mistake(item.mark, (*path, index), "these are one and the same"))
    return mistakes


def _check_tails(
    model: type[BaseModel], plain: Node, path: Path, laws: dict[Path, tuple[Any, Node]]
) -> list[Mistake]:
    if check(model, plain, path, ("plugin",))[1]:
        return []  # reported where the block is checked
    mistakes = []
    for at, (law, written) in laws.items():
        for tail in (-TAIL, TAIL):
            value = float(law.at(tail))
            _, found = check(model, _replace(plain, {at: value}), path, ("plugin",))
            if found:
                text = f"draws reach {value:.4g}: {found[0].text.partition(', found')[0]}"
                hint = "cut the law: {law: truncated, of: {...}, low: ..., high: ...}"
                mistakes.append(Mistake(written.mark, (*path, *at), text, hint))
    return mistakes


def _replace(node: Node, values: dict[Path, float]) -> Node:
    if () in values:
        return Node(values[()], node.mark, node.key)
    steps: list[tuple[str | int, Node]] = [*node.entries.items(), *enumerate(node.items)]
    changed = {
        step: _replace(child, {at[1:]: value for at, value in values.items() if at[0] == step})
        for step, child in steps
    }
    if isinstance(node.value, dict):
        return Node({str(step): child for step, child in changed.items()}, node.mark, node.key)
    return Node(list(changed.values()) if isinstance(node.value, list) else node.value, node.mark, node.key)
