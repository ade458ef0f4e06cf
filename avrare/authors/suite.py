"""Which checks a component is put to, and those of a whole distribution."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import Any

from avrare.authors.outcome import Check, Outcome
from avrare.authors.subject import Subject
from avrare.errors import PluginError, UsageError, did_you_mean
from avrare.estimation.loop import checked_options
from avrare.plugin.component import KINDS
from avrare.plugin.registry import Registry, Row

_MODULES = {
    "estimator": ("avrare.authors.description", "avrare.authors.estimating"),
    "executor": ("avrare.authors.description", "avrare.authors.executing"),
}
_PARTS = ("avrare.authors.description", "avrare.authors.behaviour")


def checks_of(kind: str) -> list[Check]:
    """The checks of a kind of component, those of the description first.

    Raises:
        UsageError: There is no such kind.
    """
    if kind not in KINDS:
        raise UsageError(f"unknown kind {kind!r}", did_you_mean(kind, KINDS))
    modules = _MODULES.get(kind, _PARTS)
    return [Check(function) for name in modules for function in importlib.import_module(name).CHECKS]


def subjects(registry: Registry, name: str, options: Mapping[str, Any]) -> list[Subject]:
    """The components of a distribution, or of that name.

    Raises:
        PluginError: There is none, or it could not be loaded.
        UsageError: Options are given for more than one, or they are wrong.
    """
    rows = [row for row in registry.rows() if name in (row.name, row.distribution)]
    if not rows:
        known = {word for row in registry.rows() for word in (row.name, row.distribution) if word}
        raise PluginError(f"no component or distribution {name!r} is installed", did_you_mean(name, known))
    for row in rows:
        if row.component is None or row.status not in ("ok", "missing dependency"):
            raise PluginError(f"{row.name} of {row.origin}: {_trouble(row)}")
    if options and len(rows) > 1:
        raise UsageError(f"{name!r} has {len(rows)} components: options are for one", "name the component")
    found = [Subject(row, dict(options)) for row in rows]
    if options:
        checked_options(found[0].model, found[0].name, dict(options), found[0].kind)
    return found


def examine(subject: Subject) -> Iterator[Outcome]:
    """Run all checks of a component, one after the other."""
    return (check.run(subject) for check in checks_of(subject.kind))


def _trouble(row: Row) -> str:
    return f"{row.status}: {row.detail}" if row.detail else row.status
