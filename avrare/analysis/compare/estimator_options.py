"""Arms of a comparison: estimators with their options, as the command line names them.

    mc,ams,ams:particles=100:discard=10

Commas separate the arms, colons an estimator from its options. Inside brackets and braces neither does, so
that a value may be any YAML.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from avrare.base.errors import UsageError, did_you_mean
from avrare.driving import Scene
from avrare.estimation.plan.plan import Estimator
from avrare.plugin.component import Component
from avrare.plugin.registry import Registry
from avrare.scenario.overrides import override
from avrare.scenario.schema import Block
from avrare.scenario.validation import check_options
from avrare.scenario.value_positions import Mark, Node
from avrare.scenario.yaml import parse_value

_SCENARIO = "scenario"  # prefix of a --set key of the scenario itself
_EXAMPLE = "for example mc,ams,ams:particles=100:discard=10"


@dataclass(frozen=True)
class Arm:
    """Estimator with its options."""

    label: str  # as the user wrote it
    name: str
    options: Mapping[str, Any]  # that are set; the others have their defaults
    config: Any  # all options, validated
    component: Component
    distribution: str = ""
    version: str = ""  # of the distribution

    @property
    def label_parts(self) -> list[str]:
        """Name and options as they are written in the label."""
        return _split_outside_brackets(self.label, ":")

    def build(self, scene: Scene | None = None) -> Estimator:
        """Build the estimator; ``scene`` as component factories take it."""
        return self.component.build(self.config, scene)  # type: ignore[no-any-return]


def make_arm(registry: Registry, name: str, options: Mapping[str, object], label: str | None = None) -> Arm:
    """Make an arm; UsageError if the options are invalid, PluginError if no plugin provides the estimator."""
    component = registry.require("estimator", name)
    row = registry.find("estimator", name)
    settings = ("seed", "budget", "workers", "confidence")
    if shared := [option for option in settings if option in options]:
        problem = f"{shared[0]!r} is a setting of the whole comparison, not an option of an estimator"
        raise UsageError(f"{label or name}: {problem}")
    config = check_options(component.load_config(), name, dict(options))
    return Arm(label or name, name, options, config, component, row.distribution, row.version)


def parse_arms(
    text: str, settings: Sequence[str], scenario_block: Block | None, registry: Registry
) -> list[Arm]:
    """Parse ``--estimators``; UsageError or PluginError if it or a setting is invalid.

    ``settings`` (``NAME.OPTION=VALUE``) apply to all arms of an estimator. They override the options of
    ``scenario_block``, the scenario's own estimator; an arm's own options override both.
    """
    parts = [_split_outside_brackets(part.strip(), ":") for part in _split_outside_brackets(text, ",")]
    labels = [":".join(part) for part in parts]
    for label in labels:
        if not label or labels.count(label) > 1:
            problem = f"{label!r} appears twice" if label else "an estimator's name is missing"
            raise UsageError(f"estimators: {problem}", _EXAMPLE)
    _check_settings(settings, {part[0] for part in parts})
    return [
        make_arm(registry, part[0], _collect_options(part, settings, scenario_block), label)
        for part, label in zip(parts, labels, strict=True)
    ]


def split_settings(settings: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split ``--set`` values into those of the scenario, without their prefix, and those of estimators."""
    prefix = f"{_SCENARIO}."
    of_scenario = [setting.removeprefix(prefix) for setting in settings if setting.startswith(prefix)]
    return of_scenario, [setting for setting in settings if not setting.startswith(prefix)]


def _collect_options(
    part: Sequence[str], settings: Sequence[str], scenario_block: Block | None
) -> dict[str, object]:
    name, options = part[0], part[1:]
    for option in options:
        if "=" not in option:
            problem = f"{option!r} in {':'.join(part)!r} should be OPTION=VALUE"
            raise UsageError(f"estimators: {problem}", _EXAMPLE)
    # In rising precedence: the scenario, --set, the arm itself.
    start: dict[str, Any] = {}
    if scenario_block is not None and scenario_block.plugin == name:
        start = scenario_block.config.model_dump(mode="json", exclude_unset=True)
    mark = Mark("estimators")
    tree = Node({name: parse_value(json.dumps(start), mark)}, mark)
    shared = [setting for setting in settings if _estimator_of(setting) == name]
    return dict(override(tree, [*shared, *(f"{name}.{option}" for option in options)]).plain()[name])


def _check_settings(settings: Sequence[str], names: set[str]) -> None:
    for setting in settings:
        name = _estimator_of(setting)
        if name not in names:
            key = setting.partition("=")[0]
            raise UsageError(
                f"{key}: should be NAME.OPTION=VALUE, for an estimator that is compared, or "
                f"{_SCENARIO}.KEY=VALUE",
                did_you_mean(name or key, [*names, _SCENARIO]),
            )


def _estimator_of(setting: str) -> str:
    name, dot, _ = setting.partition("=")[0].partition(".")
    return name.strip() if dot else ""


def _split_outside_brackets(text: str, separator: str) -> list[str]:
    parts, depth = [""], 0
    for letter in text:
        depth += (letter in "[{") - (letter in "]}")
        if letter == separator and depth <= 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts
