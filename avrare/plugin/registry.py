"""Which components are installed. A plugin that is broken becomes a row with the reason, never a crash."""

from __future__ import annotations

import functools
import importlib.util
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

import pluggy

import avrare
from avrare.errors import PluginError, did_you_mean
from avrare.plugin import builtin
from avrare.plugin.component import KINDS, Component
from avrare.plugin.hookspecs import API_VERSION, GROUP, HookSpecs
from avrare.plugin.known import FIRST_PARTY, pip_line

VARIABLE = "AVRARE_PLUGINS"
"""Environment variable: the entry points to load, separated by commas; set but empty means none."""

Status = Literal["ok", "missing dependency", "broken", "incompatible", "blocked"]


@dataclass(frozen=True)
class Row:
    """One line of ``avrare plugins``.

    Attributes:
        kind: One of ``KINDS``, or empty for a plugin that could not be loaded.
        name: Of the component, or of the entry point that could not be loaded.
        distribution: Where it comes from.
        version: Of the distribution.
        status: Whether it can be used.
        detail: The reason where it cannot, with the pip line where that helps.
        summary: The plugin's own words.
        component: The description, None for a plugin that could not be loaded.
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
    """Components by kind and name.

    Args:
        points: Entry points of the group ``avrare``.
        only: The names of those to load; None for all. The others are not imported.
    """

    def __init__(self, points: Iterable[EntryPoint] = (), only: Iterable[str] | None = None) -> None:
        self._manager = pluggy.PluginManager(GROUP)
        self._manager.add_hookspecs(HookSpecs)
        self._rows: list[Row] = []
        self.register(builtin, "avrare", "avrare", avrare.__version__)
        wanted = None if only is None else set(only)
        found = sorted(points, key=lambda point: (point.name, point.value))
        for point in found:
            self._load(point, blocked=wanted is not None and point.name not in wanted)
        for name in sorted((wanted or set()) - {point.name for point in found}):
            self._rows.append(Row("", name, "", "", "broken", f"named by {VARIABLE}, but not installed"))

    @classmethod
    def discover(cls) -> Registry:
        """The installed plugins, as far as the environment variable ``AVRARE_PLUGINS`` lets them in."""
        names = os.environ.get(VARIABLE)
        only = None if names is None else [name.strip() for name in names.split(",") if name.strip()]
        return cls(entry_points(group=GROUP), only)

    def register(self, plugin: object, name: str, distribution: str = "", version: str = "") -> None:
        """Add the components of a plugin that is already imported.

        Args:
            plugin: Module or object with the hook ``avrare_components``.
            name: A name of its own.
            distribution: Where it comes from.
            version: Of the distribution.
        """
        try:
            self._manager.register(plugin, name)
            hooks = self._manager.hook.avrare_components.get_hookimpls()
            mine = [hook for hook in hooks if hook.plugin_name == name]
            if not mine:
                raise TypeError("it has no hook avrare_components")
            function: Callable[[], Any] = mine[0].function
            parts = [_component(item) for item in function()]
            self._rows += [_row(part, distribution, version) for part in parts]
        except (Exception, SystemExit) as error:
            self._rows.append(Row("", name, distribution, version, "broken", _reason(error)))

    def _load(self, point: EntryPoint, blocked: bool) -> None:
        distribution = point.dist.name if point.dist else ""
        version = point.dist.version if point.dist else ""
        if blocked:
            row = Row("", point.name, distribution, version, "blocked", f"not named by {VARIABLE}")
            self._rows.append(row)
            return
        try:
            plugin = point.load()
        except (Exception, SystemExit) as error:
            self._rows.append(Row("", point.name, distribution, version, "broken", _reason(error)))
        else:
            self.register(plugin, point.name, distribution, version)

    def rows(self) -> list[Row]:
        """Every component and every plugin that could not be loaded, by kind and name.

        Dependencies are looked for, not imported.
        """
        order = {kind: place for place, kind in enumerate(KINDS)}
        checked = [self._checked(row) for row in self._rows]
        return sorted(checked, key=lambda row: (order.get(row.kind, len(order)), row.name, row.distribution))

    def _checked(self, row: Row) -> Row:
        if row.status != "ok" or row.component is None:
            return row
        twins = [other for other in self._rows if other is not row and _same(other, row)]
        if twins:
            both = " and ".join(sorted(one.origin for one in (row, *twins)))
            return _with(row, "broken", f"{row.kind} {row.name!r} is provided by both {both}")
        missing = missing_dependencies(row.component)
        if missing:
            return _with(row, "missing dependency", f"needs {', '.join(missing)}: {pip_line(*missing)}")
        return row

    def names(self, kind: str) -> list[str]:
        """The names of the components of a kind."""
        return sorted({row.name for row in self._rows if row.kind == kind})

    def find(self, kind: str, name: str) -> Row:
        """The component ``name`` with where it comes from; its dependencies may be missing.

        Raises:
            PluginError: It is unknown, not installed, ambiguous or incompatible.
        """
        rows = [self._checked(row) for row in self._rows if (row.kind, row.name) == (kind, name)]
        if not rows:
            raise self._unknown(kind, name)
        row = rows[0]
        if row.status == "broken":
            raise PluginError(row.detail, f"uninstall one of them, or choose plugins with {VARIABLE}")
        if row.status == "incompatible":
            raise PluginError(
                f"{kind} {name!r} of {row.origin}: {row.detail}", f"pip install -U {row.distribution}"
            )
        return row

    def get(self, kind: str, name: str) -> Component:
        """The component ``name``; its dependencies may be missing (``require`` checks them).

        Raises:
            PluginError: It is unknown, not installed, ambiguous or incompatible.
        """
        component = self.find(kind, name).component
        assert component is not None
        return component

    def require(self, kind: str, name: str) -> Component:
        """The component ``name``, ready to be built.

        Raises:
            PluginError: As for ``get``, or a dependency is missing.
        """
        component = self.get(kind, name)
        missing = missing_dependencies(component)
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
            return PluginError(f"{kind} {name!r}: provided by {failed.origin}, which is {_state(failed)}")
        others = [row.kind for row in self._rows if row.name == name and row.kind]
        if others:
            return PluginError(f"unknown {kind} {name!r}", f"{name!r} is a {others[0]}; {self._list(kind)}")
        known = {*self.names(kind), *(word for where, word in FIRST_PARTY if where == kind)}
        return PluginError(f"unknown {kind} {name!r}", did_you_mean(name, known) or self._list(kind))

    def _list(self, kind: str) -> str:
        names = self.names(kind)
        return f"installed {kind}s: {', '.join(names)}" if names else f"no {kind} plugin is installed"


def missing_dependencies(component: Component) -> tuple[str, ...]:
    """The top-level modules that the component needs and Python does not find; none is imported."""
    tops = dict.fromkeys(module.split(".")[0] for module in component.needs)
    return tuple(top for top in tops if not _findable(top))


def _findable(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):  # ValueError: imported already, but without a spec
        return False


def _component(item: object) -> Component:
    """The description, if it is one.

    Raises:
        TypeError: It is not a ``Component``, or its fields make no sense.
    """
    if not isinstance(item, Component):
        raise TypeError(f"avrare_components returned {item!r}, which is not a Component")
    if item.kind not in KINDS:
        raise TypeError(
            f"component {item.name!r} has the unknown kind {item.kind!r}; known: {', '.join(KINDS)}"
        )
    for field in ("name", "config", "factory", "summary"):
        value = getattr(item, field)
        if not isinstance(value, str) or (field in ("config", "factory") and ":" not in value):
            raise TypeError(
                f"component {item.name!r}: {field} is {value!r}; expected 'package.module:attribute'"
            )
    for field in ("rules", "check"):
        value = getattr(item, field)
        if not isinstance(value, str) or (value and ":" not in value):
            raise TypeError(
                f"component {item.name!r}: {field} is {value!r}; expected 'package.module:function'"
            )
    return item


def _row(part: Component, distribution: str, version: str) -> Row:
    fits = part.api == API_VERSION
    detail = "" if fits else f"written for plugin interface {part.api}, this avrare speaks {API_VERSION}"
    status: Status = "ok" if fits else "incompatible"
    return Row(part.kind, part.name, distribution, version, status, detail, part.summary, part)


def _same(one: Row, other: Row) -> bool:
    return (one.kind, one.name) == (other.kind, other.name)


def _with(row: Row, status: Status, detail: str) -> Row:
    return Row(row.kind, row.name, row.distribution, row.version, status, detail, row.summary, row.component)


def _state(row: Row) -> str:
    """What is the matter with a distribution that should have provided a component."""
    if row.status == "blocked":
        return f"left out by {VARIABLE}"
    return row.status if not row.detail else f"{row.status}: {row.detail}"


def _reason(error: BaseException) -> str:
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


@functools.cache
def default_registry() -> Registry:
    """The installed plugins, discovered once per process."""
    return Registry.discover()
