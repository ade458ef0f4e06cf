"""The component that is checked: its description, options and built part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from pydantic import BaseModel, ValidationError

from avrare.authors.outcome import Skipped
from avrare.authors.road import scene
from avrare.driving import Scene
from avrare.estimation.loop import checked_options
from avrare.plugin.component import Component
from avrare.plugin.registry import Registry, Row, default_registry, missing_dependencies

ROAD_KINDS = ("perception", "tracker", "controller", "specification")
"""Kinds whose parts are made for a simulator's ``Scene``, where it has one."""


@dataclass(frozen=True)
class Subject:
    """A component of a plugin.

    Attributes:
        row: Description and distribution.
        options: Beside the defaults; without them the example of the model is taken, where it has one.
    """

    row: Row
    options: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def installed(cls, kind: str, name: str, registry: Registry | None = None, **options: Any) -> Subject:
        """The component of that kind and name.

        Raises:
            PluginError: It is unknown, broken or incompatible.
        """
        return cls((registry or default_registry()).find(kind, name), options)

    @property
    def component(self) -> Component:
        """The description."""
        assert self.row.component is not None
        return self.row.component

    @property
    def kind(self) -> str:
        """One of ``KINDS``."""
        return self.row.kind

    @property
    def name(self) -> str:
        """As a scenario writes it."""
        return self.row.name

    @cached_property
    def model(self) -> type[Any]:
        """The class of the options."""
        return self.component.load_config()

    @property
    def scene(self) -> Scene | None:
        """The reference road, for parts that may ask for one."""
        return scene() if self.kind in ROAD_KINDS else None

    @cached_property
    def config(self) -> Any:
        """Options to build the part with: those given, else the defaults, else the model's example.

        Raises:
            UsageError: Options are given, and they are unknown or invalid.
            Skipped: Some option has no default, and there is no example.
        """
        if self.options:
            return checked_options(self.model, self.name, dict(self.options), self.kind)
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
        """A new part.

        Raises:
            Skipped: It cannot be built here: a package is missing, or options are.
        """
        missing = missing_dependencies(self.component)
        if missing:
            raise Skipped(f"needs {', '.join(missing)}, which is not installed")
        config = self.config
        return self.component.load_factory()(config, self.scene)


def _example(model: type[BaseModel]) -> dict[str, Any] | None:
    """The first of ``model_config = ConfigDict(json_schema_extra={"examples": [...]})``."""
    extra = model.model_config.get("json_schema_extra")
    examples = extra.get("examples") if isinstance(extra, dict) else None
    first = examples[0] if isinstance(examples, list) and examples else None
    return first if isinstance(first, dict) else None
