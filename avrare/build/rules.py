"""A rule by its name, or a formula over vehicles, whichever plugin offers it."""

from __future__ import annotations

from collections.abc import Sequence

from avrare.build.stack import build_block
from avrare.driving import Scene
from avrare.errors import PluginError, UsageError
from avrare.plugin.catalogue import Catalogue
from avrare.plugin.registry import Registry, Row, default_registry
from avrare.protocols import Specification
from avrare.scenario.explain import check, scenario_error
from avrare.scenario.overrides import override
from avrare.scenario.schema import Block
from avrare.scenario.source import Mark, Node


def build_rule(
    name: str, settings: Sequence[str], scene: Scene, registry: Registry | None = None
) -> Specification:
    """The monitor of a plugin's rule.

    Args:
        name: As ``avrare rules`` lists it.
        settings: ``KEY=VALUE`` options of the plugin, as after ``--set``.
        scene: Road, sizes and names.
        registry: Where plugins are looked up; the installed ones by default.

    Raises:
        UsageError: There is no such rule, or two plugins offer one.
        ScenarioError: An option is unknown or has a wrong value.
    """
    registry = registry or default_registry()
    offers = Catalogue.of(registry).find(name)
    if len(offers) > 1:
        both = " and ".join(offer.row.name for offer in offers)
        raise UsageError(
            f"rule {name!r} is offered by {both}", "write it into a scenario and use --specification"
        )
    return _configured(registry, offers[0].row, "rule", name, settings, scene)


def build_formula(
    text: str, settings: Sequence[str], scene: Scene, registry: Registry | None = None
) -> Specification:
    """The monitor of a formula over vehicles, whose predicates a plugin defines.

    Args:
        text: Such as ``forall o in others: always (time_to_collision(ego, o) > 1.5)``.
        settings: ``KEY=VALUE`` options of the plugin, as after ``--set``.
        scene: Road, sizes and names.
        registry: Where plugins are looked up; the installed ones by default.

    Raises:
        PluginError: No plugin takes formulas over vehicles.
        ScenarioError: An option is unknown or has a wrong value.
    """
    registry = registry or default_registry()
    rows = dict.fromkeys(offer.row for offer in Catalogue.of(registry).offers)
    for row in rows:
        if row.component is not None and "formula" in row.component.load_config().model_fields:
            return _configured(registry, row, "formula", text, settings, scene)
    raise PluginError("no installed plugin knows predicates of vehicles", "pip install avrare-traffic-rules")


def _configured(
    registry: Registry, row: Row, key: str, value: str, settings: Sequence[str], scene: Scene
) -> Specification:
    component = registry.require("specification", row.name)
    mark = Mark("--rule" if key == "rule" else "--stl")
    node = override(Node({key: Node(value, mark, mark)}, mark), settings)
    config, problems = check(component.load_config(), node)
    if config is None:
        raise scenario_error(problems)
    block = Block(row.name, component, config, row.distribution, row.version)
    return build_block(block, scene)  # type: ignore[no-any-return]
