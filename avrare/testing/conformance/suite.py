"""Conformance suite: the checks of each kind of component, and the components of a distribution."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import Any

from avrare.base.errors import PluginError, UsageError, did_you_mean
from avrare.plugin.component import KINDS
from avrare.plugin.registry import Registry
from avrare.scenario.validation import check_options
from avrare.testing.conformance.check_outcome import Check, Outcome
from avrare.testing.conformance.component_under_test import Subject

_MODULES = {"estimator": "estimator_checks", "executor": "executor_checks"}
"""Kind -> module of its own checks; all other kinds have behaviour checks."""


def checks_of(kind: str) -> list[Check]:
    """Return the checks of a kind of component, description checks first.

    Raises:
        UsageError: There is no such kind.
    """
    if kind not in KINDS:
        raise UsageError(f"unknown kind {kind!r}", did_you_mean(kind, KINDS))
    names = ("description_checks", _MODULES.get(kind, "behaviour_checks"))
    modules = [importlib.import_module(f"avrare.testing.conformance.{name}") for name in names]
    return [Check(function) for module in modules for function in module.CHECKS]


def subjects(registry: Registry, name: str, options: Mapping[str, Any]) -> list[Subject]:
    """Return the components of a distribution, or those of this name.

    Raises:
        PluginError: There is none, or it could not be loaded.
        UsageError: Options are invalid, or given for more than one component.
    """
    rows = [row for row in registry.rows() if name in (row.name, row.distribution)]
    if not rows:
        known = {word for row in registry.rows() for word in (row.name, row.distribution) if word}
        raise PluginError(f"no component or distribution {name!r} is installed", did_you_mean(name, known))
    for row in rows:
        if row.component is None or row.status not in ("ok", "missing dependency"):
            status = f"{row.status}: {row.detail}" if row.detail else row.status
            raise PluginError(f"{row.name} of {row.origin}: {status}")
    if options and len(rows) > 1:
        raise UsageError(f"{name!r} has {len(rows)} components: options are for one", "name the component")
    found = [Subject(row, dict(options)) for row in rows]
    if options:
        check_options(found[0].model, found[0].name, dict(options), found[0].kind)
    return found


def examine(subject: Subject) -> Iterator[Outcome]:
    """Run all checks of a component, one after the other."""
    return (check.run(subject) for check in checks_of(subject.kind))
