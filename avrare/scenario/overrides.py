"""Overrides ``--set a.b=c``: single values of a scenario, applied last."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Self

from avrare.base.errors import ScenarioError, UsageError
from avrare.scenario.value_positions import Mark, Node, put
from avrare.scenario.yaml import parse_value


class Setting(str):
    """``KEY=VALUE`` whose errors begin with ``source``: what the user wrote for it."""

    source: str

    def __new__(cls, text: str, source: str) -> Self:
        """Return the setting."""
        setting = super().__new__(cls, text)
        setting.source = source
        return setting


def as_settings(settings: Sequence[str]) -> tuple[str, ...]:
    """Return settings as a tuple; a string is a single one, and not a sequence of its letters."""
    return (settings,) if isinstance(settings, str) else tuple(settings)


def read_driver(text: str) -> list[Setting]:
    """Return the settings that ``CONTROLLER=MODEL`` stands for; none for the path of a file.

    Raises:
        UsageError: The text is neither.
    """
    plugin, sign, model = text.partition("=")
    if os.path.exists(text) or (not sign and os.path.splitext(text)[1]):
        return []
    if not (plugin and model):
        hint = "write CONTROLLER=MODEL, such as reference_driver=fsm, or the path of a scenario file"
        raise UsageError(f"--against {text}: no file, and no controller with its model", hint)
    settings = f"controller={{plugin: {plugin}, model: {model}}}", "aeb=null"
    return [Setting(setting, f"--against {text}") for setting in settings]


def override(tree: Node, settings: Sequence[str]) -> Node:
    """Apply every ``KEY=VALUE`` in order and return the new tree.

    KEY is a dotted path in which a number indexes a list; a missing key is added, and the schema decides
    later whether it is allowed. VALUE is YAML. The error lists all bad settings.
    """
    problems: list[tuple[str, str | None]] = []
    for setting in as_settings(settings):
        try:
            tree = _apply(tree, setting)
        except ScenarioError as error:
            problems += error.problems
    if problems:
        raise ScenarioError(problems)
    return tree


def _apply(tree: Node, setting: str) -> Node:
    key, equals, text = setting.partition("=")
    key = key.strip()
    mark = Mark(setting.source if isinstance(setting, Setting) else f"--set {key}")
    if not equals or not all(key.split(".")):
        raise mark.error("should be KEY=VALUE", "for example --set estimator.rollouts=1000")
    if key.split(".")[0] == "extends":
        raise mark.error("extends cannot be set here", "edit the scenario file")
    value = parse_value(text, mark)
    if key == "cross_check" and value.value is True and tree.entries_at(key):
        return tree  # the options of the file ask for the check already
    return put(tree, tuple(key.split(".")), value, mark)
