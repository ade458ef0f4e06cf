"""Registry of installed components; a broken plugin becomes a row with the reason, never a crash."""

from __future__ import annotations

import functools
import importlib.util
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from types import NoneType
from typing import Any, Literal

import pluggy

from avrare.base import version
from avrare.base.errors import PluginError, UsageError, did_you_mean
from avrare.base.health_messages import MESSAGES
from avrare.plugin import first_party
from avrare.plugin.component import (
    API_VERSION,
    CHARTS,
    GROUP,
    KINDS,
    AutoRole,
    CheckRole,
    Component,
    HookSpecs,
)
from avrare.plugin.first_party import FIRST_PARTY, pip_line

VARIABLE = "AVRARE_PLUGINS"
"""Environment variable with the entry points to load, separated by commas; empty means none."""

Status = Literal["ok", "missing dependency", "broken", "incompatible", "blocked"]


@dataclass(frozen=True)
class Row:
    """Line of ``avrare plugins``; ``detail`` says why a component cannot be used, and its remedy.

    If the plugin could not be loaded, the kind is empty, the name is that of its entry point, without a
    component.
    """

    kind: str
    name: str
    distribution: str
    version: str
    status: Status
    detail: str = ""
    summary: str = ""
    component: Component | None = None

    @property
    def origin(self) -> str:
        """Distribution and version, for messages."""
        return f"{self.distribution} {self.version}".strip()


class Registry:
    """Registry of components by kind and name.

    Args:
        points: Entry points of the group ``avrare``.
        only: Names of the entry points to load; None for all. The others are not imported.
    """

    def __init__(self, points: Iterable[EntryPoint] = (), only: Iterable[str] | None = None) -> None:
        self._manager = pluggy.PluginManager(GROUP)
        self._manager.add_hookspecs(HookSpecs)
        self._rows: list[Row] = []
        self.register(first_party, "avrare", "avrare", version.__version__)
        selected = None if only is None else set(only)
        sorted_points = sorted(points, key=lambda point: (point.name, point.value))
        for point in sorted_points:
            self._load(point, blocked=selected is not None and point.name not in selected)
        for name in sorted((selected or set()) - {point.name for point in sorted_points}):
            self._rows.append(Row("", name, "", "", "broken", f"named by {VARIABLE}, but not installed"))

    @classmethod
    def discover(cls) -> Registry:
        """Load the installed plugins that the environment variable ``AVRARE_PLUGINS`` allows."""
        names = os.environ.get(VARIABLE)
        only = None if names is None else [name.strip() for name in names.split(",") if name.strip()]
        return cls(entry_points(group=GROUP), only)

    def register(self, plugin: object, name: str, distribution: str = "", version: str = "") -> None:
        """Add the components of an imported module or object with the hook ``avrare_components``.

        The name must be unique.
        """
        try:
            self._manager.register(plugin, name)
            hooks = self._manager.hook.avrare_components.get_hookimpls()
            own_hooks = [hook for hook in hooks if hook.plugin_name == name]
            if not own_hooks:
                raise TypeError("it has no hook avrare_components")
            function: Callable[[], Any] = own_hooks[0].function
            self._rows += [_row(component, distribution, version) for component in function()]
        except (Exception, SystemExit) as error:
            self._rows.append(Row("", name, distribution, version, "broken", _reason(error)))

    def _load(self, point: EntryPoint, blocked: bool) -> None:
        origin = (point.dist.name, point.dist.version) if point.dist else ("", "")
        if blocked:
            self._rows.append(Row("", point.name, *origin, "blocked", f"not named by {VARIABLE}"))
            return
        try:
            plugin = point.load()
        except (Exception, SystemExit) as error:
            self._rows.append(Row("", point.name, *origin, "broken", _reason(error)))
        else:
            self.register(plugin, point.name, *origin)

    def rows(self) -> list[Row]:
        """Return all components and plugins that could not be loaded, by kind and name.

        Dependencies are searched for, not imported.
        """
        order = {kind: place for place, kind in enumerate(KINDS)}
        checked = [self._check(row) for row in self._rows]
        return sorted(checked, key=lambda row: (order.get(row.kind, len(order)), row.name, row.distribution))

    def _check(self, row: Row) -> Row:
        if row.status != "ok" or row.component is None:
            return row
        key = (row.kind, row.name)
        twins = [other for other in self._rows if other is not row and (other.kind, other.name) == key]
        if twins:
            both = " and ".join(sorted(twin.origin for twin in (row, *twins)))
            return replace(row, status="broken", detail=f"{row.kind} {row.name!r} is provided by both {both}")
        missing = list_missing_dependencies(row.component)
        if missing:
            detail = f"needs {', '.join(missing)}: {pip_line(*missing)}"
            return replace(row, status="missing dependency", detail=detail)
        return row

    def names(self, kind: str) -> list[str]:
        """Return the names of the components of a kind."""
        return sorted({row.name for row in self._rows if row.kind == kind})

    def usable(self, kind: str) -> list[Component]:
        """Return the components of a kind that can be built, by name."""
        rows = [self._check(row) for row in self._rows if row.kind == kind]
        components = [row.component for row in rows if row.status == "ok" and row.component is not None]
        return sorted(components, key=lambda component: component.name)

    def checkers(self) -> list[Component]:
        """Return the estimators that can cross-check others."""
        return [component for component in self.usable("estimator") if component.cross_check is not None]

    def candidates(self) -> list[tuple[Component, AutoRole]]:
        """Return the estimators that ``auto`` may choose, in the order in which it tries them."""
        estimators = self.usable("estimator")
        pairs = [(component, component.auto) for component in estimators if component.auto is not None]
        return sorted(pairs, key=lambda pair: pair[1].order)

    def family(self, estimator: str) -> str:
        """Return the family of an estimator; its name where it is not installed."""
        component = self._find_estimator(estimator)
        return estimator if component is None else component.family

    def charts(self, estimator: str) -> str:
        """Return the reference to the charts of an estimator; the default where it is not installed."""
        component = self._find_estimator(estimator)
        return CHARTS if component is None else component.charts

    def _find_estimator(self, name: str) -> Component | None:
        rows = [row for row in self._rows if (row.kind, row.name) == ("estimator", name)]
        return next((row.component for row in rows if row.component is not None), None)

    def versions(self, components: Iterable[Component]) -> dict[str, str]:
        """Return the versions of the distributions that these components come from."""
        rows = [self.find(component.kind, component.name) for component in components]
        return {row.distribution: row.version for row in rows if row.distribution}

    def warnings(self) -> dict[str, str]:
        """Return the texts of all health warnings, the core's and those of the components, by name."""
        declared = [row.component.warnings for row in self._rows if row.component is not None]
        return {**MESSAGES, **{name: text for texts in declared for name, text in texts.items()}}

    def check_suppressed(self, names: Iterable[str]) -> None:
        """Raise a ``UsageError`` for a name of no health warning, and for a warning that must be shown."""
        for name in names:
            if name == "errors":
                raise UsageError(
                    "health warning 'errors' cannot be suppressed", "raise max_error_rate instead"
                )
            if name not in MESSAGES and name not in (texts := self.warnings()):
                hint = did_you_mean(name, texts.keys() - {"errors"})
                raise UsageError(f"unknown health warning {name!r}", hint)

    def find(self, kind: str, name: str) -> Row:
        """Return the row of the component ``name``; its dependencies may be missing.

        Raises:
            PluginError: It is unknown, not installed, ambiguous or incompatible.
        """
        rows = [self._check(row) for row in self._rows if (row.kind, row.name) == (kind, name)]
        if not rows:
            raise self._unknown(kind, name)
        row = rows[0]
        if row.status == "broken":
            raise PluginError(row.detail, f"uninstall one of them, or select plugins with {VARIABLE}")
        if row.status == "incompatible":
            text = f"{kind} {name!r} of {row.origin}: {row.detail}"
            raise PluginError(text, f"pip install -U {row.distribution}")
        return row

    def get(self, kind: str, name: str) -> Component:
        """Return the component ``name``; its dependencies may be missing (``require`` checks them)."""
        component = self.find(kind, name).component
        assert component is not None
        return component

    def require(self, kind: str, name: str) -> Component:
        """Return the component ``name`` after checking its dependencies."""
        component = self.get(kind, name)
        missing = list_missing_dependencies(component)
        if missing:
            raise PluginError(f"{kind} {name!r} needs {', '.join(missing)}", pip_line(*missing))
        return component

    def _unknown(self, kind: str, name: str) -> PluginError:
        home = FIRST_PARTY.get((kind, name))
        if home:
            failed = next((row for row in self._rows if row.distribution == home), None)
            if failed is None:
                message = f"unknown {kind} {name!r}: provided by {home}, which is not installed"
                return PluginError(message, f"pip install {home}")
            state = f"excluded by {VARIABLE}" if failed.status == "blocked" else failed.status
            if failed.detail and failed.status != "blocked":
                state += f": {failed.detail}"
            return PluginError(f"{kind} {name!r}: provided by {failed.origin}, which is {state}")
        others = [row.kind for row in self._rows if row.name == name and row.kind]
        if others:
            return PluginError(f"unknown {kind} {name!r}", f"{name!r} is a {others[0]}; {self._list(kind)}")
        words = {*self.names(kind), *(word for where, word in FIRST_PARTY if where == kind)}
        hint = did_you_mean(name, words) or self._list(kind)
        if broken := [f"{row.origin} ({row.detail})" for row in self._rows if row.status == "broken"]:
            hint += f"; failed to load: {', '.join(broken)}"
        return PluginError(f"unknown {kind} {name!r}", hint)

    def _list(self, kind: str) -> str:
        names = self.names(kind)
        return f"installed {kind}s: {', '.join(names)}" if names else f"no {kind} plugin is installed"


def list_missing_dependencies(component: Component) -> tuple[str, ...]:
    """Return the top-level modules that the component needs and Python does not find; imports none."""
    missing = []
    for top in dict.fromkeys(module.split(".")[0] for module in component.needs):
        try:
            installed = importlib.util.find_spec(top) is not None
        except (ImportError, ValueError):  # ValueError: imported already, but without a spec
            installed = False
        if not installed:
            missing.append(top)
    return tuple(missing)


def _row(component: object, distribution: str, version: str) -> Row:
    if not isinstance(component, Component):
        raise TypeError(f"avrare_components returned {component!r}, which is not a Component")
    if component.kind not in KINDS:
        kinds = ", ".join(KINDS)
        raise TypeError(
            f"component {component.name!r} has the unknown kind {component.kind!r}; known: {kinds}"
        )
    for field in ("name", "summary", "config", "factory", "rules", "check", "charts", "family"):
        value = getattr(component, field)
        is_reference = field in ("config", "factory", "charts") or (field in ("rules", "check") and value)
        if not isinstance(value, str) or (is_reference and ":" not in value):
            text = f"component {component.name!r}: {field} is {value!r}"
            raise TypeError(f"{text}; expected 'package.module:attribute'" if is_reference else text)
    for field, role in (("cross_check", CheckRole), ("auto", AutoRole)):
        if not isinstance(value := getattr(component, field), (role, NoneType)):
            raise TypeError(
                f"component {component.name!r}: {field} is {value!r}, not of type {role.__name__}"
            )
    if not all(isinstance(word, str) for pair in component.warnings.items() for word in pair):
        raise TypeError(
            f"component {component.name!r}: warnings should be texts by name, not {component.warnings!r}"
        )
    fits = component.api == API_VERSION
    detail = "" if fits else f"written for plugin interface {component.api}; this avrare has {API_VERSION}"
    status: Status = "ok" if fits else "incompatible"
    return Row(
        component.kind, component.name, distribution, version, status, detail, component.summary, component
    )


def _reason(error: BaseException) -> str:
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


@functools.cache
def default_registry() -> Registry:
    """Return the registry of the installed plugins, discovered once per process."""
    return Registry.discover()
