"""``--set a.b=c``: single values laid over a scenario, last of all."""

from __future__ import annotations

from collections.abc import Sequence

from avrare.errors import ScenarioError, did_you_mean
from avrare.scenario.source import Mark, Node, Path
from avrare.scenario.yaml import parse_value


def override(tree: Node, settings: Sequence[str]) -> Node:
    """The tree with every ``KEY=VALUE`` applied in order.

    KEY is a dotted path in which a number indexes a list; a key that is not there yet is added, and the
    schema decides later whether it may be. VALUE is YAML.

    Raises:
        ScenarioError: A setting without ``=``, with a bad value, or with a path that leads nowhere; all of
            them at once.
    """
    problems: list[tuple[str, str | None]] = []
    for setting in settings:
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
        raise ScenarioError([(f"{mark}: should be KEY=VALUE", "for example --set estimator.rollouts=1000")])
    if key.split(".")[0] == "extends":
        raise ScenarioError([(f"{mark}: extends cannot be set here", "edit the scenario file")])
    return _put(tree, tuple(key.split(".")), parse_value(text, mark), mark)


def _put(node: Node, path: Path, value: Node, mark: Mark) -> Node:
    """A copy of ``node`` in which ``path`` holds ``value``."""
    if not path:
        return value
    step, rest = str(path[0]), path[1:]
    if isinstance(node.value, list):
        index = _index(node.value, step, mark)
        items = list(node.value)
        items[index] = _put(items[index], rest, value, mark)
        return Node(items, node.mark, node.key)
    if node.value is not None and not isinstance(node.value, dict):
        raise ScenarioError([(f"{mark}: there is no {step!r} inside {node.value!r}", "shorten the path")])
    if step == "plugin" and not rest and "plugin" in node.entries:
        node = _renamed(node, value)
    empty = Node({}, mark, mark)
    return Node(
        {**node.entries, step: _put(node.entries.get(step, empty), rest, value, mark)}, node.mark, node.key
    )


def _renamed(block: Node, plugin: Node) -> Node:
    """A component block without its options when it gets another plugin: they mean nothing to that one."""
    if block.entries["plugin"].value == plugin.value:
        return block
    return Node({}, block.mark, block.key)


def _index(items: list[Node], step: str, mark: Mark) -> int:
    if step.isascii() and step.isdigit() and len(step) < 9 and int(step) < len(items):
        return int(step)
    known = [str(i) for i in range(len(items))]
    raise ScenarioError(
        [(f"{mark}: the list has no item {step!r}", did_you_mean(step, known) or "it is empty")]
    )
