"""The estimators of a comparison, as the command line names them.

    mc,ams,ams:particles=100:discard=10

Commas part the estimators, colons an estimator from its options; inside brackets and braces neither does, so
that a value may be any YAML.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from avrare.errors import UsageError, did_you_mean
from avrare.estimation.loop import checked_options
from avrare.estimation.plan import Estimator
from avrare.plugin.component import Component
from avrare.plugin.registry import Registry
from avrare.scenario.overrides import override
from avrare.scenario.schema import Block
from avrare.scenario.source import Mark, Node
from avrare.scenario.yaml import parse_value

SCENARIO = "scenario"
"""What ``--set`` writes before a key of the scenario itself."""
_EXAMPLE = "for example mc,ams,ams:particles=100:discard=10"
_MARK = Mark("--estimators")
_SHARED = ("seed", "budget", "workers", "confidence")
"""What all estimators have in common, and none has as an option."""


@dataclass(frozen=True)
class Arm:
    """One estimator with its options.

    Attributes:
        label: As the user wrote it.
        name: Of the estimator.
        options: Those that are set; the others have their defaults.
        config: All of them, checked.
        component: Its description.
        distribution: Where it comes from.
        version: Of the distribution.
    """

    label: str
    name: str
    options: Mapping[str, Any]
    config: Any
    component: Component
    distribution: str = ""
    version: str = ""

    @property
    def words(self) -> list[str]:
        """The label's parts: the name, and each option as it is written."""
        return _split(self.label, ":")

    def build(self, scene: object | None = None) -> Estimator:
        """The estimator; ``scene`` as component factories take it."""
        return self.component.load_factory()(self.config, scene)  # type: ignore[no-any-return]


def arm(registry: Registry, name: str, options: Mapping[str, Any], label: str | None = None) -> Arm:
    """An estimator with its options.

    Raises:
        UsageError: Options that do not fit.
        PluginError: Nobody provides it.
    """
    component = registry.require("estimator", name)
    row = registry.find("estimator", name)
    for option in (option for option in _SHARED if option in options):
        raise UsageError(f"{label or name}: {option!r} is no option of one estimator: all of them share it")
    config = checked_options(component.load_config(), name, dict(options))
    return Arm(label or name, name, options, config, component, row.distribution, row.version)


def parse_arms(text: str, settings: Sequence[str], own: Block | None, registry: Registry) -> list[Arm]:
    """The estimators that ``text`` names.

    Args:
        text: As after ``--estimators``.
        settings: ``NAME.OPTION=VALUE``, for all variants of an estimator; what a variant says itself wins.
        own: The scenario's estimator block: its options are where that estimator starts from.
        registry: Where estimators are looked up.

    Raises:
        UsageError: The text, an option or a setting makes no sense.
        PluginError: Nobody provides one of the estimators.
    """
    words = [_split(word.strip(), ":") for word in _split(text, ",")]
    labels = [":".join(word) for word in words]
    for label in labels:
        if not label or labels.count(label) > 1:
            text = f"{label!r} stands there twice" if label else "an estimator's name is missing"
            raise UsageError(f"--estimators: {text}", _EXAMPLE)
    _check_settings(settings, {word[0] for word in words})
    return [
        arm(registry, word[0], _options(word, settings, own), label)
        for word, label in zip(words, labels, strict=True)
    ]


def part_settings(settings: Sequence[str]) -> tuple[list[str], list[str]]:
    """``--set`` values that are the scenario's (without their prefix), and those of estimators."""
    prefix = f"{SCENARIO}."
    mine = [setting.removeprefix(prefix) for setting in settings if setting.startswith(prefix)]
    return mine, [setting for setting in settings if not setting.startswith(prefix)]


def _options(word: Sequence[str], settings: Sequence[str], own: Block | None) -> dict[str, Any]:
    """The scenario's, then those of ``--set``, then those of the variant itself."""
    name, variant = word[0], word[1:]
    for option in variant:
        if "=" not in option:
            raise UsageError(
                f"--estimators: {option!r} in {':'.join(word)!r} should be OPTION=VALUE", _EXAMPLE
            )
    start: dict[str, Any] = {}
    if own is not None and own.plugin == name:
        start = own.config.model_dump(mode="json", exclude_unset=True)
    tree = Node({name: parse_value(json.dumps(start), _MARK)}, _MARK)
    mine = [setting for setting in settings if _estimator_of(setting) == name]
    return dict(override(tree, [*mine, *(f"{name}.{option}" for option in variant)]).plain()[name])


def _check_settings(settings: Sequence[str], names: set[str]) -> None:
    for setting in settings:
        name = _estimator_of(setting)
        if name not in names:
            key = setting.partition("=")[0]
            hint = did_you_mean(name or key, [*names, SCENARIO])
            raise UsageError(
                f"--set {key}: should be NAME.OPTION=VALUE, for an estimator that is compared, or "
                f"{SCENARIO}.KEY=VALUE",
                hint,
            )


def _estimator_of(setting: str) -> str:
    """The name before the first dot of the key; empty where there is none."""
    name, dot, _ = setting.partition("=")[0].partition(".")
    return name.strip() if dot else ""


def _split(text: str, mark: str) -> list[str]:
    """The text cut at ``mark``, except inside brackets and braces."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter in "[{") - (letter in "]}")
        if letter == mark and depth <= 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts
