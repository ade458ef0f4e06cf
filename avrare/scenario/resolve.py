"""From a merged tree of values to a ``Scenario``: schema, the plugins' own options, and cross checks."""

from __future__ import annotations

from pydantic import BaseModel

from avrare.errors import ExitCode, PluginError, did_you_mean
from avrare.plugin.registry import Registry, Row
from avrare.scenario.explain import Problem, check, describe, scenario_error
from avrare.scenario.findings import check_block
from avrare.scenario.formulas import check_formula, step_of
from avrare.scenario.schema import PARTS, Block, Document, Formula, Scenario
from avrare.scenario.source import Node, Path

_CORE = {"estimator": ("plugin", "specifications")}
"""Keys of a block that the core reads itself, where it is more than ``plugin``."""


def resolve(tree: Node, path: str, registry: Registry) -> Scenario:
    """Check everything that can be checked without building the stack.

    Args:
        tree: The mapping of the file after ``extends`` and overrides.
        path: The file, as the user wrote it.
        registry: Where plugins are looked up.

    Raises:
        ScenarioError: All the problems, by place.
    """
    document, problems = check(Document, tree)
    blocks: dict[str, Block] = {}
    for key in PARTS:
        node = tree.child(key)
        if node is not None and isinstance(node.value, dict):
            block, found = _block(key, node, (key,), registry)
            problems += found
            if block:
                blocks[key] = block
    steps = document.steps if document else None
    specifications, found, warnings = _specifications(tree, registry, step_of(blocks.get("simulator")), steps)
    problems += found + _cross_checks(tree)
    if problems or document is None:
        raise scenario_error(problems)
    chosen = document.estimator.get("specifications") or list(specifications)
    settings = {key: getattr(document, key) for key in _SETTINGS}
    return Scenario(
        path=path,
        specifications=specifications,
        estimated=tuple(name for name in specifications if name in chosen),
        warnings=tuple((warning.message, warning.hint) for warning in warnings),
        **blocks,  # type: ignore[arg-type]  # keys are PARTS
        **settings,
    )


_SETTINGS = tuple(key for key in Document.model_fields if key not in (*PARTS, "specifications"))


def _block(kind: str, node: Node, path: Path, registry: Registry) -> tuple[Block | None, list[Problem]]:
    """A component block, its options checked by the plugin's own model."""
    plugin = node.child("plugin")
    if plugin is None:
        hint = f"installed: {', '.join(registry.names(kind)) or 'none'}"
        return None, [Problem(node.name_mark, (*path, "plugin"), "required, but missing", hint)]
    where = (*path, "plugin")
    if not isinstance(plugin.value, str):
        return None, [Problem(plugin.mark, where, f"should be a string, found {describe(plugin)}")]
    try:
        row = registry.find(kind, plugin.value)
        model = _config(row)
    except PluginError as error:
        return None, [Problem(plugin.mark, where, error.message, error.hint, ExitCode.PLUGIN)]
    config, problems = check(model, node, path, _CORE.get(kind, ("plugin",)))
    if config is None or row.component is None:
        return None, problems
    return Block(plugin.value, row.component, config, row.distribution, row.version), problems


def _config(row: Row) -> type[BaseModel]:
    """The pydantic model of a component's options.

    Raises:
        PluginError: It cannot be imported, or is something else.
    """
    assert row.component is not None
    what = f"{row.kind} {row.name!r} of {row.origin or 'an unknown distribution'}"
    try:
        model = row.component.load_config()
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise PluginError(f"{what} is broken: {reason}", "avrare plugins") from None
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        raise PluginError(f"{what} is broken: {row.component.config} is not a pydantic model")
    return model


def _specifications(
    tree: Node, registry: Registry, dt: float | None, steps: int | None
) -> tuple[dict[str, Block | Formula], list[Problem], list[Problem]]:
    """The specifications, what is wrong with them, and what only deserves a warning."""
    parts: dict[str, Block | Formula] = {}
    problems: list[Problem] = []
    warnings: list[Problem] = []
    whole = tree.child("specifications")
    for name, node in (whole.entries if whole else {}).items():
        path = ("specifications", name)
        part: Block | Formula | None = None
        if not isinstance(node.value, dict):
            continue  # the schema has said so already
        if "stl" in node.value and "plugin" not in node.value:
            part, found = check(Formula, node, path)
            if part:
                errors, doubts = check_formula(part, node, path, dt, steps)
                found += errors
                warnings += doubts
        elif "stl" in node.value or "plugin" not in node.value:
            text = "should have either 'stl' or 'plugin'"
            found = [Problem(node.name_mark, path, text, 'for example {stl: "always (gap > 2.0)"}')]
        else:
            part, found = _block("specification", node, path, registry)
            if part:
                errors, doubts = check_block(part, node, path, dt)
                found += errors
                warnings += doubts
        problems += found
        if part:
            parts[name] = part
    return parts, problems, warnings


def _cross_checks(tree: Node) -> list[Problem]:
    """Names of specifications, wherever they are used, must exist."""
    whole = tree.child("specifications")
    known = whole.entries if whole else {}
    problems = _chosen(tree, known)
    thresholds = tree.child("thresholds")
    for index, item in enumerate(
        thresholds.value if thresholds and isinstance(thresholds.value, list) else []
    ):
        node = item.child("specification")
        if node is not None and isinstance(node.value, str):
            problems += _named(node, ("thresholds", index, "specification"), known)
    return problems


def _chosen(tree: Node, known: dict[str, Node]) -> list[Problem]:
    """The estimator option ``specifications``, which the core handles for every estimator."""
    estimator = tree.child("estimator")
    node = estimator.child("specifications") if estimator else None
    if node is None:
        return []
    path = ("estimator", "specifications")
    if not isinstance(node.value, list) or not node.value:
        text = f"should be a list of specification names, found {describe(node)}"
        return [Problem(node.mark, path, text, "leave it out to estimate all of them")]
    return [found for i, item in enumerate(node.value) for found in _named(item, (*path, i), known)]


def _named(node: Node, path: Path, known: dict[str, Node]) -> list[Problem]:
    if isinstance(node.value, str) and node.value in known:
        return []
    word = str(node.value)
    return [Problem(node.mark, path, f"there is no specification {word!r}", did_you_mean(word, known))]
