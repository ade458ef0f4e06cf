"""``extends``: scenario files merged over the files that they extend."""

from __future__ import annotations

import os
import re

from avrare.base.errors import ScenarioError, did_you_mean
from avrare.base.stored_files import open_regular
from avrare.scenario.safe_mode import TRUST, is_outside, is_safe
from avrare.scenario.value_positions import Mark, Node, merge, printable
from avrare.scenario.yaml import MAX_BYTES, parse


def read(path: str) -> Node:
    """Read a file and merge it over the files that it extends; the key ``extends`` is removed."""
    folder = os.path.dirname(path) or "."
    if is_safe() and is_outside(path, folder):
        raise Mark(path).error("safe mode: this is a link to a file outside its folder", TRUST)
    return _read(path, folder, named_at=None, seen=())


def _read(path: str, folder: str, named_at: Mark | None, seen: tuple[str, ...]) -> Node:
    tree = parse(_content(path, named_at), path)
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
        raise parent.mark.error(
            f"extends: files extend each other in a circle: {chain}", "remove one 'extends'"
        )
    if is_safe() and is_outside(base, folder):
        raise parent.mark.error(f"extends: safe mode: {base!r} is outside the scenario's folder", TRUST)
    return merge(_read(base, folder, parent.mark, seen), tree)


def _base(parent: Node, path: str) -> str:
    target = parent.value
    if not isinstance(target, str) or not target:
        raise parent.mark.error(
            "extends: should be the path of a scenario file", "for example _base/highway.yaml"
        )
    if os.path.isabs(target) or re.match(r"[A-Za-z][A-Za-z0-9+.-]*:|~|\\", target):
        hint = f"write it relative to {os.path.dirname(path) or 'the folder of this file'}"
        raise parent.mark.error(f"extends: {target!r} is not a local relative path", hint)
    return os.path.normpath(os.path.join(os.path.dirname(path), target))


def _content(path: str, named_at: Mark | None) -> bytes:
    where = f"{named_at}: extends: {printable(path)}" if named_at else printable(path)
    try:
        given_pipe = named_at is None and path.startswith("/dev/")  # <(...) on the command line
        with open(path, "rb") if given_pipe else open_regular(path) as file:
            return file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise ScenarioError([(f"{where}: no such file", _similar_files(path, named_at))]) from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = (error.strerror or str(error)).lower() if isinstance(error, OSError) else error
        hint = "give a scenario file" if isinstance(error, IsADirectoryError) else None
        raise ScenarioError([(f"{where}: cannot be read: {reason}", hint)]) from None


def _similar_files(path: str, named_at: Mark | None) -> str | None:
    folder, name = os.path.split(path)
    try:
        names = os.listdir(folder or ".")
    except OSError:
        missing = f"there is no folder {printable(folder)}"
        return f"{missing}: copy the scenarios that it extends, too" if named_at else missing
    files = [file for file in names if file.endswith((".yaml", ".yml"))]
    return did_you_mean(path, [os.path.join(folder, file) for file in files]) if name else None
