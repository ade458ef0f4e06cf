"""Overrides ``--set a.b=c``: single values of a scenario, applied last."""

from __future__ import annotations

from collections.abc import Sequence

from avrare.base.errors import ScenarioError, did_you_mean
from avrare.scenario.value_positions import Mark, Node, Path
from avrare.scenario.yaml import parse_value


def as_settings(settings: Sequence[str]) -> tuple[str, ...]:
    """Return settings as a tuple; a string is a single one, and not a sequence of its letters."""
    return (settings,) if isinstance(settings, str) else tuple(settings)


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
    mark = Mark(f"--set {key}")
    if not equals or not all(key.split(".")):
        raise mark.error("should be KEY=VALUE", "for example --set estimator.rollouts=1000")
    if key.split(".")[0] == "extends":
        raise mark.error("extends cannot be set here", "edit the scenario file")
    value = parse_value(text, mark)
    if key == "cross_check" and value.value is True and tree.entries_at(key):
        return tree  # the options of the file ask for the check already
    return put(tree, tuple(key.split(".")), value, mark)


def put(node: Node, path: Path, value: Node, mark: Mark) -> Node:
    """Return the tree with another value at a path; ``mark`` is the place of what asks for it."""
    if not path:
        return value
    step, rest = str(path[0]), path[1:]
    if isinstance(node.value, list):
        index = _index(node.value, step, mark)
        items = list(node.value)
        items[index] = put(items[index], rest, value, mark)
        return Node(items, node.mark, node.key)
    if node.value is not None and not isinstance(node.value, dict):
        raise mark.error(f"there is no {step!r} inside {node.value!r}", "shorten the path")
    entries = node.entries
    if step == "plugin" and not rest and step in entries and entries[step].value != value.value:
        entries = {}  # the options of one plugin mean nothing to another
    changed = put(entries.get(step, Node({}, mark, mark)), rest, value, mark)
    return Node({**entries, step: changed}, node.mark, node.key)


def _index(items: list[Node], step: str, mark: Mark) -> int:
    if step.isascii() and step.isdigit() and len(step) < 9 and int(step) < len(items):
        return int(step)
    known = [str(i) for i in range(len(items))]
    raise mark.error(f"the list has no item {step!r}", did_you_mean(step, known) or "it is empty")
