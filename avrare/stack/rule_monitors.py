"""Monitors of named rules and of formulas over vehicles, which plugins provide."""

from __future__ import annotations

from collections.abc import Sequence

from avrare.base.errors import PluginError, UsageError
from avrare.driving import Scene
from avrare.plugin.registry import Registry, Row, default_registry
from avrare.plugin.rule_catalogue import Catalogue
from avrare.protocols import Specification
from avrare.scenario.marked_values import Mark, Node
from avrare.scenario.overrides import override
from avrare.scenario.schema import Block
from avrare.scenario.validation import check, scenario_error
from avrare.stack.builder import build_block


def build_rule(
    name: str, settings: Sequence[str], scene: Scene, registry: Registry | None = None
) -> Specification:
    """Build the monitor of a plugin's rule.

    Args:
        name: Name of the rule as ``avrare rules`` lists it.
        settings: ``KEY=VALUE`` options of the plugin, as for ``--set``.
        scene: Road, sizes and names.
        registry: Registry of plugins; the installed ones by default.

    Raises:
        UsageError: There is no such rule, or two plugins offer one.
        ScenarioError: An option is unknown or has a wrong value.
    """
    registry = registry or default_registry()
    offers = Catalogue.of(registry).find(name)
    if len(offers) > 1:
        both = " and ".join(offer.row.name for offer in offers)
        raise UsageError(
            f"rule {name!r} is offered by {both}",
            "put it in a scenario and choose it with --specification",
        )
    return _build_configured(registry, offers[0].row, "rule", name, settings, scene)


def build_formula(
    text: str, settings: Sequence[str], scene: Scene, registry: Registry | None = None
) -> Specification:
    """Build the monitor of a formula over vehicles, whose predicates a plugin defines.

    Args:
        text: Formula such as ``forall o in others: always (time_to_collision(ego, o) > 1.5)``.
        settings: ``KEY=VALUE`` options of the plugin, as for ``--set``.
        scene: Road, sizes and names.
        registry: Registry of plugins; the installed ones by default.

    Raises:
        PluginError: No installed plugin defines predicates of vehicles.
        ScenarioError: An option is unknown or has a wrong value.
    """
    registry = registry or default_registry()
    rows = dict.fromkeys(offer.row for offer in Catalogue.of(registry).offers)
    for row in rows:
        if row.component is not None and "formula" in row.component.load_config().model_fields:
            return _build_configured(registry, row, "formula", text, settings, scene)
    raise PluginError(
        "no installed plugin defines predicates of vehicles", "pip install avrare-traffic-rules"
    )


def _build_configured(
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
