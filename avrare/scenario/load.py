"""A scenario from its file: read, extend, override, check."""

from __future__ import annotations

import os
from collections.abc import Sequence

from avrare.plugin.registry import Registry, default_registry
from avrare.scenario.merge import read
from avrare.scenario.overrides import override
from avrare.scenario.resolve import resolve
from avrare.scenario.schema import Scenario
from avrare.scenario.source import Mark, Node


def load(
    path: str | os.PathLike[str],
    overrides: Sequence[str] = (),
    estimator: str | None = None,
    registry: Registry | None = None,
) -> Scenario:
    """Read and check a scenario; nothing is built and nothing heavy is imported.

    Args:
        path: The YAML file.
        overrides: ``KEY=VALUE`` settings as after ``--set``, applied last, in order.
        estimator: Name of an estimator whose defaults replace the file's whole estimator block first.
        registry: Where plugins are looked up; the installed ones by default.

    Raises:
        ScenarioError: Everything that is wrong, each with its place.
    """
    file = os.fspath(path)
    tree = override(_with_estimator(read(file), estimator), overrides)
    return resolve(tree, file, registry or default_registry())


def _with_estimator(tree: Node, name: str | None) -> Node:
    """The tree with the estimator block that holds before ``--set``: named, the file's own, or plain mc."""
    own = tree.child("estimator")
    if name is None and own is not None and own.value is not None:
        return tree
    mark = tree.mark if name is None else Mark("--estimator")
    block = Node({"plugin": Node("mc" if name is None else name, mark, mark)}, mark, mark)
    return Node({**tree.entries, "estimator": block}, tree.mark, tree.key)
