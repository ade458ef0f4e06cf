"""Safe mode: an untrusted scenario may name installed plugins and the files of its own folder only."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.metadata import entry_points

from pydantic import BaseModel

from avrare.base.errors import ExitCode, UsageError
from avrare.plugin.component import GROUP
from avrare.plugin.options import CODE, FILE, Options
from avrare.plugin.registry import Row
from avrare.scenario.validation import Mistake, find_places
from avrare.scenario.value_positions import Node, Path, printable

VARIABLE = "AVRARE_SAFE"
"""Environment variable that switches safe mode on for all commands; empty or 0 means off."""

_active: ContextVar[bool] = ContextVar("safe", default=False)
TRUST = "outside safe mode this is allowed: switch it off only for scenarios that you trust"


@contextmanager
def safe_mode(on: bool = True) -> Iterator[None]:
    """Load scenarios safely within the block; ``on`` False changes nothing."""
    token = _active.set(_active.get() or on)
    try:
        yield
    finally:
        _active.reset(token)


def is_safe() -> bool:
    """Return whether scenarios are loaded safely."""
    return _active.get() or os.environ.get(VARIABLE, "") not in ("", "0")


def is_outside(path: str | os.PathLike[str], folder: str | os.PathLike[str]) -> bool:
    """Return whether a path leads out of a folder, by ``..`` or by a link."""
    root = os.path.realpath(folder)
    try:
        return os.path.commonpath([root, os.path.realpath(path)]) != root
    except ValueError:  # another drive, or a NUL in the path
        return True


def refuse_outside(path: str | os.PathLike[str], folder: str | os.PathLike[str], what: str) -> None:
    """Raise a ``UsageError`` in safe mode if a path leads out of the scenario's folder."""
    if is_safe() and is_outside(path, folder):
        raise UsageError(f"{what} {printable(os.fspath(path))} leads out of the scenario's folder", TRUST)


def check_import_path(folder: str) -> None:
    """Raise a ``UsageError`` in safe mode if files of the scenario's or the current folder could be imported.

    Python would find them before its own modules, as after ``python -m avrare``.
    """
    if not is_safe():
        return
    places = [os.path.realpath(place) for place in sys.path]
    standard_library = os.path.realpath(sysconfig.get_path("stdlib"))
    before = places[: places.index(standard_library)] if standard_library in places else places
    for place in dict.fromkeys((os.path.realpath(folder), os.path.realpath("."))):
        if place in before:
            raise UsageError(
                f"safe mode: Python would import any file in {printable(place)}",
                "call `avrare`, or `python -P -m avrare`, and leave this folder out of PYTHONPATH",
            )


def find_refusals(row: Row, model: type[BaseModel], node: Node, path: Path, folder: str) -> list[Mistake]:
    """List the entries of a component's block that safe mode refuses; the model has not seen the options yet.

    Settings on the command line are the user's own and are not refused.
    """
    if not is_safe():
        return []
    if not row.distribution:
        text = f"safe mode: {row.kind} {row.name!r} is of no installed plugin"
        return [Mistake(node.name_mark, path, text, TRUST, ExitCode.PLUGIN)]
    mistakes = []
    places = find_places(model, node)
    for at, place in places.items():
        word, mark = place.node.value, place.node.mark
        if not isinstance(word, str) or not mark.line or at == ("plugin",):
            continue
        above = [places[at[:depth]] for depth in range(1, len(at) + 1)]
        reason = None
        if not any(option.is_marked(FILE) for option in above):
            reason = _code_refusal(word, row, any(option.is_marked(CODE) for option in above))
        reason = reason or _file_refusal(word, folder)
        if reason is not None:
            mistakes.append(Mistake(mark, (*path, *at), f"safe mode: {reason}", TRUST))
    return mistakes


def find_linked_files(node: Node, path: Path, config: Options | None, folder: str) -> list[Mistake]:
    """List the files that complete a named one and that safe mode refuses: links to others outside."""
    files = config.used_files().values() if config is not None and is_safe() else ()
    text = "safe mode: {} is a link to a file outside the scenario's folder"
    return [
        Mistake(node.name_mark, path, text.format(printable(os.fspath(file))), TRUST)
        for file in files
        if is_outside(file, folder) and not is_outside(os.path.dirname(file), folder)
    ]


def _file_refusal(text: str, folder: str) -> str | None:
    looks_like_path = os.path.isabs(text) or text[:1] in ("~", "\\") or ".." in re.split(r"[/\\]", text)
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*://", text):
        return f"{text!r} is not a file of the scenario's folder"
    exists = os.path.exists(text) if "/" in text else os.path.isfile(text)
    if (looks_like_path or exists) and (text[:1] == "~" or is_outside(text, folder)):
        return f"{text!r} is a file outside the scenario's folder"
    return None


def _code_refusal(text: str, row: Row, is_code: bool) -> str | None:
    reference = re.fullmatch(r"([A-Za-z_]\w*)(\.[A-Za-z_]\w*)*(:[A-Za-z_][\w.-]*)?", text)
    if reference is None:
        return f"{text!r} is code of no installed plugin" if is_code else None
    top, dotted, attribute = reference.groups()
    if not is_code and attribute is None and (dotted is None or not _is_module(top)):
        return None
    if top in _plugin_modules(row):
        return None
    return f"{text!r} would import {top!r}, which is not an installed plugin"


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):  # ValueError: imported already, but without a spec
        return True


def _plugin_modules(row: Row) -> set[str]:
    needs = row.component.needs if row.component is not None else ()
    modules = [*(point.module for point in entry_points(group=GROUP)), *needs]
    return {"avrare", *(module.partition(".")[0] for module in modules)}
