"""Component under test: its description, options and built part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from pydantic import BaseModel, ValidationError

from avrare.driving import Scene
from avrare.plugin.component import Component
from avrare.plugin.registry import Registry, Row, default_registry, missing_dependencies
from avrare.scenario.validation import check_options
from avrare.testing.conformance.check_outcome import Skipped
from avrare.testing.conformance.sample_traffic import scene

ROAD_KINDS = ("perception", "tracker", "controller", "specification")
"""Kinds whose parts are built for the ``Scene`` of a simulator, where it has one."""


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
    def installed(cls, kind: str, name: str, registry: Registry | None = None, **options: Any) -> Subject:
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
        return scene() if self.kind in ROAD_KINDS else None

    @cached_property
    def config(self) -> Any:
        """Options of the part: those given, else the defaults, else the example of the model.

        Raises:
            UsageError: Given options are unknown or invalid.
            Skipped: An option has no default, and there is no example.
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
        """Build a new part.

        Raises:
            Skipped: A package or an option is missing.
        """
        missing = missing_dependencies(self.component)
        if missing:
            raise Skipped(f"needs {', '.join(missing)}, which is not installed")
        config = self.config
        return self.component.load_factory()(config, self.scene)


def _example(model: type[BaseModel]) -> dict[str, Any] | None:
    """Return the first of ``model_config = ConfigDict(json_schema_extra={"examples": [...]})``."""
    extra = model.model_config.get("json_schema_extra")
    examples = extra.get("examples") if isinstance(extra, dict) else None
    first = examples[0] if isinstance(examples, list) and examples else None
    return first if isinstance(first, dict) else None
