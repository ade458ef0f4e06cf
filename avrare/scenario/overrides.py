"""Overrides: files that extend others (``extends``), and single values (``--set a.b=c``), applied last."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Self

from avrare.base.errors import ScenarioError, UsageError, did_you_mean
from avrare.base.stored_files import open_regular
from avrare.scenario.safe_mode import TRUST, is_outside, is_safe
from avrare.scenario.value_positions import Mark, Node, merge, printable, put
from avrare.scenario.yaml import MAX_BYTES, parse, parse_value


class Setting(str):
    """``KEY=VALUE`` whose errors begin with ``source``: what the user wrote for it."""

    source: str

    def __new__(cls, text: str, source: str) -> Self:
        """Return the setting."""
        setting = super().__new__(cls, text)
        setting.source = source
        return setting


def as_settings(settings: Sequence[str]) -> tuple[str, ...]:
    """Return settings as a tuple; a string is a single one, and not a sequence of its letters."""
    return (settings,) if isinstance(settings, str) else tuple(settings)


def read_driver(text: str) -> list[Setting]:
    """Return the settings that ``CONTROLLER=MODEL`` abbreviates; empty for the path of a file.

    Raises:
        UsageError: The text is neither.
    """
    plugin, sign, model = text.partition("=")
    if os.path.exists(text) or (not sign and os.path.splitext(text)[1]):
        return []
    if not (plugin and model):
        hint = "write CONTROLLER=MODEL, such as reference_driver=fsm, or the path of a scenario file"
        raise UsageError(f"--against {text}: no file, and no controller with its model", hint)
    settings = f"controller={{plugin: {plugin}, model: {model}}}", "aeb=null"
    return [Setting(setting, f"--against {text}") for setting in settings]


def override(tree: Node, settings: Sequence[str]) -> Node:
    """Apply every ``KEY=VALUE`` in order and return the new tree.

    KEY is a dotted path in which a number indexes a list; a missing key is added, and the schema decides
    later whether it is allowed. VALUE is YAML. The error lists all bad settings.
    """
    problems: list[tuple[str, str | None]] = []
    for setting in as_settings(settings):
        try:
            tree = _apply(tree, setting)
        except ScenarioError as error:
            problems += error.problems
    if problems:
        raise ScenarioError(problems)
    return tree


def _apply(tree: Node, setting: str) -> Node:
    key, equals, text = setting.partition("=")
    key = key.strip()
    mark = Mark(setting.source if isinstance(setting, Setting) else f"--set {key}")
    if not equals or not all(key.split(".")):
        raise mark.error("should be KEY=VALUE", "for example --set estimator.rollouts=1000")
    if key.split(".")[0] == "extends":
        raise mark.error("extends cannot be set here", "edit the scenario file")
    value = parse_value(text, mark)
    if key == "cross_check" and value.value is True and tree.entries_at(key):
        return tree  # the options of the file ask for the check already
    return put(tree, tuple(key.split(".")), value, mark)


def read_extended(path: str) -> Node:
    """Read a file and merge it over the files that it extends; the key ``extends`` is removed."""
    folder = os.path.dirname(path) or "."
    if is_safe() and is_outside(path, folder):
        raise Mark(path).error("safe mode: this is a link to a file outside its folder", TRUST)
    return _read_chain(path, folder, named_at=None, ancestors=())


def _read_chain(path: str, folder: str, named_at: Mark | None, ancestors: tuple[str, ...]) -> Node:
    tree = parse(_content(path, named_at), path)
    assert isinstance(tree.value, dict)
    entries = dict(tree.value)
    parent = entries.pop("extends", None)
    tree = Node(entries, tree.mark)
    if parent is None or parent.value is None:
        return tree
    base = _base(parent, path)
    real = os.path.realpath(base)
    ancestors = (*ancestors, os.path.realpath(path))
    if real in ancestors:
        chain = " -> ".join(os.path.basename(file) for file in (*ancestors, real))
        raise parent.mark.error(
            f"extends: files extend each other in a circle: {chain}", "remove one 'extends'"
        )
    if is_safe() and is_outside(base, folder):
        raise parent.mark.error(f"extends: safe mode: {base!r} is outside the scenario's folder", TRUST)
    return merge(_read_chain(base, folder, parent.mark, ancestors), tree)


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
