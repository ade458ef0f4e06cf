"""A component as a plugin describes it: names and import strings, no classes.

Listing and validating therefore import nothing heavy: ``config`` is imported to check a scenario,
``factory`` only where the part is built.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from avrare.plugin.finding import Finding
from avrare.plugin.rulecard import RuleCard

KINDS = (
    "simulator",
    "perception",
    "tracker",
    "controller",
    "specification",
    "estimator",
    "executor",
)


@dataclass(frozen=True)
class Component:
    """One part that a scenario may name with ``plugin:``.

    Attributes:
        kind: One of ``KINDS``.
        name: What a scenario writes after ``plugin:``.
        config: ``"package.module:Class"`` of a pydantic model; must import nothing heavy.
        factory: ``"package.module:function"``, called as ``factory(config, scene)`` where ``scene`` is the
            simulator's ``Scene`` (None for simulators, estimators and where there is none).
        summary: One line for ``avrare plugins``.
        needs: Modules that the factory imports beyond NumPy.
        api: Version of the plugin interface it was written for.
        rules: ``"package.module:function"`` returning a list of ``RuleCard``, for a specification that offers
            rules by name (its option ``rule``); empty for everything else. Must import nothing heavy.
        check: ``"package.module:function"`` of a specification whose options can be wrong in ways that the
            model cannot see: called as ``check(config, dt)`` when a scenario is loaded, with the simulator's
            step [s] or None where it is not known; returns a list of ``Finding``. Must import nothing heavy.
        driving: It is for vehicles on a road, and refused where the simulator has no ``Scene``.
    """

    kind: str
    name: str
    config: str
    factory: str
    summary: str
    needs: tuple[str, ...] = ()
    api: int = 1
    rules: str = ""
    check: str = ""
    driving: bool = False

    def load_config(self) -> type[Any]:
        """The pydantic model of the part's options."""
        return resolve(self.config)  # type: ignore[no-any-return]

    def load_factory(self) -> Callable[..., Any]:
        """The function that builds the part; may import heavy packages."""
        return resolve(self.factory)  # type: ignore[no-any-return]

    def load_rules(self) -> list[RuleCard]:
        """The rules that the part offers; empty where it offers none by name."""
        return list(resolve(self.rules)()) if self.rules else []

    def find_faults(self, config: Any, dt: float | None) -> list[Finding]:
        """What the part itself has to say of its options; nothing where it has no ``check``."""
        return list(resolve(self.check)(config, dt)) if self.check else []


def resolve(reference: str) -> Any:
    """Import ``"package.module:attribute"``."""
    module, _, attribute = reference.partition(":")
    return getattr(importlib.import_module(module), attribute)
