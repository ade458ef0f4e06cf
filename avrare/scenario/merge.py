"""``extends``: a scenario file laid over the file that it extends."""

from __future__ import annotations

import os
import re

from avrare.errors import ScenarioError, did_you_mean
from avrare.scenario.source import Mark, Node, shown
from avrare.scenario.yaml import MAX_BYTES, parse


def read(path: str) -> Node:
    """The file ``path``, merged over everything that it extends; ``extends`` itself is gone.

    Raises:
        ScenarioError: A file is missing or unreadable, or files extend each other in a circle.
    """
    return _read(path, place=None, seen=())


def _read(path: str, place: Mark | None, seen: tuple[str, ...]) -> Node:
    tree = parse(_content(path, place), path)
    assert isinstance(tree.value, dict)
    entries = dict(tree.value)
    parent = entries.pop("extends", None)
    tree = Node(entries, tree.mark)
    if parent is None or parent.value is None:
        return tree
    base = _base(parent, path)
    real = os.path.realpath(base)
    seen = (*seen, os.path.realpath(path))
    if real in seen:
        chain = " -> ".join(os.path.basename(file) for file in (*seen, real))
        raise _error(parent.mark, f"files extend each other in a circle: {chain}", "remove one 'extends'")
    return merge(_read(base, parent.mark, seen), tree)


def _base(parent: Node, path: str) -> str:
    target = parent.value
    if not isinstance(target, str) or not target:
        raise _error(parent.mark, "should be the path of a scenario file", "for example _base/highway.yaml")
    if os.path.isabs(target) or re.match(r"[A-Za-z][A-Za-z0-9+.-]*:|~|\\", target):
        hint = f"write it relative to {os.path.dirname(path) or 'the folder of this file'}"
        raise _error(parent.mark, f"{target!r} is not a local relative path", hint)
    return os.path.normpath(os.path.join(os.path.dirname(path), target))


def _error(mark: Mark, text: str, hint: str | None) -> ScenarioError:
    return ScenarioError([(f"{mark}: extends: {text}", hint)])


def _content(path: str, place: Mark | None) -> bytes:
    """The bytes of a file; ``place`` is the ``extends`` that named it, None for the file itself."""
    where = f"{place}: extends: {shown(path)}" if place else shown(path)
    try:
        with open(path, "rb") as file:
            return file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise ScenarioError([(f"{where}: no such file", _near(path))]) from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ScenarioError([(f"{where}: cannot be read: {reason}", None)]) from None
    except ValueError as error:  # a NUL in the path
        raise ScenarioError([(f"{where}: cannot be read: {error}", None)]) from None


def _near(path: str) -> str | None:
    """A hint with the scenario files of that folder whose names are near."""
    folder, name = os.path.split(path)
    try:
        names = os.listdir(folder or ".")
    except OSError:
        return f"there is no folder {shown(folder)}"
    files = [file for file in names if file.endswith((".yaml", ".yml"))]
    return did_you_mean(path, [os.path.join(folder, file) for file in files]) if name else None


def merge(base: Node, over: Node) -> Node:
    """``over`` laid over ``base``: mappings deeply, everything else replaced.

    A null in ``over`` removes the inherited key. A component block that names another plugin, or a formula
    where there was a plugin, replaces the whole block: the options of one plugin mean nothing to another.
    """
    if not isinstance(base.value, dict) or not isinstance(over.value, dict) or _differ(base, over):
        return over
    entries = dict(base.value)
    for key, node in over.value.items():
        inherited = entries.get(key)
        if inherited is None:
            entries[key] = node
        elif node.value is None:
            del entries[key]
        else:
            entries[key] = merge(inherited, node)
    return Node(entries, over.mark, over.key)


def _differ(base: Node, over: Node) -> bool:
    ours, theirs = _identity(over), _identity(base)
    return ours is not None and theirs is not None and ours != theirs


def _identity(node: Node) -> object:
    """What a block is: ``stl``, the name of its plugin, or None for any other mapping."""
    if "stl" in node.entries:
        return ("stl",)
    plugin = node.entries.get("plugin")
    return ("plugin", str(plugin.value)) if plugin else None
