"""Conformance suite: components under test, the checks of each kind, and their outcomes."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from pydantic import BaseModel, JsonValue, ValidationError

from avrare.base.errors import AvrareError, PluginError, UsageError, did_you_mean
from avrare.driving import Scene
from avrare.plugin.component import KINDS, Component
from avrare.plugin.registry import Registry, Row, default_registry, list_missing_dependencies
from avrare.scenario.validation import check_options
from avrare.testing.conformance.sample_traffic import scene

Status = Literal["passed", "failed", "skipped"]


@dataclass(frozen=True)
class Subject:
    """A component of a plugin.

    Attributes:
        row: Description and distribution.
        options: Options in place of the defaults; if empty, the example of the model if it has one.
    """

    row: Row
    options: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def find_installed(
        cls, kind: str, name: str, registry: Registry | None = None, **options: object
    ) -> Subject:
        """Return the installed component of this kind and name.

        Raises:
            PluginError: It is unknown, broken or incompatible.
        """
        return cls((registry or default_registry()).find(kind, name), options)

    @property
    def component(self) -> Component:
        """Description of the component."""
        assert self.row.component is not None
        return self.row.component

    @property
    def kind(self) -> str:
        """One of ``KINDS``."""
        return self.row.kind

    @property
    def name(self) -> str:
        """Name in a scenario."""
        return self.row.name

    @cached_property
    def model(self) -> type[Any]:
        """Class of the options."""
        return self.component.load_config()

    @property
    def scene(self) -> Scene | None:
        """Sample scene, for parts that may need one."""
        # kinds whose parts are built for the ``Scene`` of a simulator, where it has one
        road_kinds = ("perception", "tracker", "controller", "specification")
        return scene() if self.kind in road_kinds else None

    @cached_property
    def config(self) -> Any:
        """Options of the part: those given, else the defaults, else the example of the model.

        Raises:
            UsageError: Given options are unknown or invalid.
            Skipped: An option has neither default nor example.
        """
        if self.options:
            return check_options(self.model, self.name, dict(self.options), self.kind)
        try:
            return self.model()
        except ValidationError as error:
            example = _example(self.model)
            if example is None:
                places = [".".join(map(str, entry["loc"])) or entry["msg"] for entry in error.errors()]
                missing = ", ".join(places)
                raise Skipped(f"no defaults for {missing}: give --set, or the model an example") from None
            return self.model(**example)

    def build(self) -> Any:
        """Build a new part; raise ``Skipped`` where a package or an option is missing."""
        missing = list_missing_dependencies(self.component)
        if missing:
            raise Skipped(f"needs {', '.join(missing)}, which is not installed")
        config = self.config  # before the import of the factory
        return self.component.build(config, self.scene)


def _example(model: type[BaseModel]) -> dict[str, JsonValue] | None:
    """Return the first of ``model_config = ConfigDict(json_schema_extra={"examples": [...]})``."""
    extra = model.model_config.get("json_schema_extra")
    examples = extra.get("examples") if isinstance(extra, dict) else None
    first = examples[0] if isinstance(examples, list) and examples else None
    return first if isinstance(first, dict) else None


class Skipped(Exception):
    """Raised where a check does not apply to a component; the message is the reason."""


@dataclass(frozen=True)
class Outcome:
    """One row of ``avrare plugins --check``.

    Attributes:
        kind: Kind of the component.
        component: Name of the component.
        check: Name of the check.
        sentence: Requirement of the check.
        status: Whether it passed.
        reason: Reason why it failed or was skipped, one line; empty where it passed.
    """

    kind: str
    component: str
    check: str
    sentence: str
    status: Status
    reason: str = ""


@dataclass(frozen=True)
class Check:
    """A function that raises where a component does not meet a requirement.

    Attributes:
        function: Function of a ``Subject``; its docstring is the requirement in one sentence.
    """

    function: Callable[[Any], None]

    @property
    def name(self) -> str:
        """Name of the check, for example ``rows_are_independent``."""
        return self.function.__name__

    @property
    def sentence(self) -> str:
        """Requirement of the check."""
        return " ".join((self.function.__doc__ or "").split())

    def run(self, subject: Any) -> Outcome:
        """Run the check; whatever the component raises becomes an outcome."""
        status, reason = self._verdict(subject)
        return Outcome(subject.kind, subject.name, self.name, self.sentence, status, reason)

    def _verdict(self, subject: object) -> tuple[Status, str]:
        try:
            self.function(subject)
        except Skipped as skipped:
            return "skipped", str(skipped)
        except AssertionError as error:
            return "failed", _first_paragraph(error) or "the check does not hold"
        except AvrareError as error:
            return "failed", " ".join(error.lines())
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit and the failure of pytest.raises are not Exceptions
            return "failed", f"{type(error).__name__}: {_first_paragraph(error)}"
        return "passed", ""


def _first_paragraph(error: BaseException) -> str:
    # on one line: messages of NumPy and pytest fill pages
    return " ".join(str(error).strip().split("\n\n")[0].split())[:300]


def checks_of(kind: str) -> list[Check]:
    """Return the checks of a kind of component, description checks first.

    Raises:
        UsageError: The kind does not exist.
    """
    if kind not in KINDS:
        raise UsageError(f"unknown kind {kind!r}", did_you_mean(kind, KINDS))
    behaviour = f"{kind}_checks" if kind in ("estimator", "executor") else "closed_loop_part_checks"
    names = ("description_checks", behaviour)
    modules = [importlib.import_module(f"avrare.testing.conformance.{name}") for name in names]
    return [Check(function) for module in modules for function in module.CHECKS]


def subjects(
    registry: Registry, name: str, options: Mapping[str, object], kind: str | None = None
) -> list[Subject]:
    """Return the components of a distribution, or those of this name; all must have been loaded."""
    rows = [row for row in registry.rows() if name in (row.name, row.distribution)]
    if not rows:
        names = {word for row in registry.rows() for word in (row.name, row.distribution) if word}
        raise PluginError(f"no component or distribution {name!r} is installed", did_you_mean(name, names))
    rows = [row for row in rows if kind in (None, row.kind)]
    if not rows:
        raise UsageError(f"{name!r} has no component of kind {kind!r}")
    for row in rows:
        if row.component is None or row.status not in ("ok", "missing dependency"):
            status = f"{row.status}: {row.detail}" if row.detail else row.status
            raise PluginError(f"component {row.name} of {row.origin} cannot be checked: {status}")
    if options and len(rows) > 1:
        text = f"{name!r} has {len(rows)} components, and options can be set for only one"
        raise UsageError(text, "name the component or its --kind")
    selected = [Subject(row, dict(options)) for row in rows]
    if options:
        check_options(selected[0].model, selected[0].name, dict(options), selected[0].kind)
    return selected


def examine(subject: Subject) -> Iterator[Outcome]:
    """Run all checks of a component, one after the other."""
    return (check.run(subject) for check in checks_of(subject.kind))
