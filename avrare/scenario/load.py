"""Loading of scenarios: read the file, merge ``extends``, apply overrides, check."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

from pydantic import BaseModel

from avrare.base.errors import AvrareError, ExitCode, PluginError, did_you_mean
from avrare.base.late_import import late_import
from avrare.plugin.registry import Registry, Row, default_registry
from avrare.scenario.drawn_options import find_draws
from avrare.scenario.draws import KEY, Draws
from avrare.scenario.extends import merge, read
from avrare.scenario.fingerprint import FILE_OPTION, is_file, marked_options
from avrare.scenario.overrides import override, put
from avrare.scenario.safe_mode import check_import_path, find_linked_files, find_refusals
from avrare.scenario.schema import PARTS, TWIN_PARTS, Block, Document, Formula, Scenario
from avrare.scenario.specification_checks import check_block, check_formula, step_of
from avrare.scenario.validation import Mistake, check, describe, scenario_error
from avrare.scenario.value_positions import Mark, Node, Path

_CORE_KEYS = {"estimator": ("plugin", "specifications"), "simulator": ("plugin", KEY)}
"""Keys of a block that the core reads itself, where there are more than ``plugin``."""
_SETTINGS = tuple(key for key in Document.model_fields if key not in (*PARTS, "specifications", "cheap"))
_NOT_OF_MEMBER = ("ensemble", "thresholds", "regression", "cross_check")
_NOT_OF_TWIN = ("cheap", *_NOT_OF_MEMBER)
_FEWEST_MEMBERS = 3
_STORED, _RESULT = "scenario.yaml", "result.json"
"""Names of the scenario in a run folder, and of what tells such a folder."""


def load(
    path: str | os.PathLike[str],
    overrides: Sequence[str] = (),
    estimator: str | Node | None = None,
    registry: Registry | None = None,
) -> Scenario:
    """Load and check a scenario; builds nothing and imports nothing heavy.

    The defaults of ``estimator``, or a block that another file has for it, replace the file's estimator
    block; ``overrides``, ``KEY=VALUE`` as after ``--set``, are applied last. The error has all mistakes, each
    with its place. In safe mode (``avrare.scenario.safe_mode``) they include what a scenario of a stranger
    may not name.
    """
    file = os.fspath(path)
    check_import_path(os.path.dirname(file) or ".")
    tree = override(_with_estimator(read(file), estimator), overrides)
    return _resolve(tree, file, registry or default_registry())


def check_estimator(node: Node, path: Path, folder: str) -> list[Mistake]:
    """List the mistakes in an estimator's block that stands at a path of a file in ``folder``."""
    return _resolve_block("estimator", node, path, default_registry(), folder)[1]


def _with_estimator(tree: Node, name: str | Node | None) -> Node:
    own, default = tree.child("estimator"), "mfmc" if tree.entries_at("cheap") else "auto"
    if isinstance(name, Node):
        return Node({**tree.entries, "estimator": name}, tree.mark, tree.key)
    if name is None and own is not None and own.value is not None:
        return tree
    mark = tree.mark if name is None else Mark("--estimator")
    block = Node({"plugin": Node(default if name is None else name, mark, mark)}, mark, mark)
    return Node({**tree.entries, "estimator": block}, tree.mark, tree.key)


def _resolve(tree: Node, path: str, registry: Registry) -> Scenario:
    folder = os.path.dirname(path) or "."
    # 1. The core's own keys; the contents of component blocks are left to the plugins' models.
    document, mistakes = check(Document, _without_options(tree))
    # 2. The component blocks.
    blocks: dict[str, Block] = {}
    for key in PARTS:
        node = tree.child(key)
        if node is not None and isinstance(node.value, dict):
            block, found = _resolve_block(key, node, (key,), registry, folder)
            mistakes += found
            if block:
                blocks[key] = block
    # 3. The specifications, and references to them.
    specifications: dict[str, Block | Formula] = {}
    warnings: list[Mistake] = []
    dt, steps = step_of(blocks.get("simulator")), document.steps if document else None
    written = tree.entries_at("specifications")
    for name, node in written.items():
        part, errors, found = _resolve_specification(name, node, registry, folder, dt, steps)
        mistakes += errors
        warnings += found
        if part:
            specifications[name] = part
    estimated, errors = _estimated(tree, written)
    mistakes += errors + _check_thresholds(tree, written)
    if document is not None and (block := blocks.get("estimator")) is not None:
        mistakes += _check_other_family(tree, document, block.plugin)
    if mistakes or document is None:
        raise scenario_error(mistakes)
    cheap, members = _resolve_twin(tree, path, registry), _resolve_members(tree, document, path, registry)
    return Scenario(
        path=path,
        cheap=cheap,
        members=members,
        cheap_cost=document.cheap.cost if document.cheap is not None else None,
        specifications=specifications,
        estimated=tuple(name for name in specifications if name in estimated),
        warnings=tuple((warning.message, warning.hint) for warning in warnings),
        **blocks,  # type: ignore[arg-type]  # keys are PARTS
        **{key: getattr(document, key) for key in _SETTINGS},
    )


def _resolve_twin(tree: Node, path: str, registry: Registry) -> Scenario | None:
    """Return the scenario whose parts are those of ``cheap``, merged over this one's."""
    given = tree.entries_at("cheap")
    if not given:
        return None
    parts = {key: node for key, node in given.items() if key in TWIN_PARTS}
    own = {key: node for key, node in tree.entries.items() if key not in _NOT_OF_TWIN}
    return _resolve(merge(Node(own, tree.mark, tree.key), Node(parts, tree.mark)), path, registry)


def _resolve_members(tree: Node, document: Document, path: str, registry: Registry) -> tuple[Scenario, ...]:
    """Return the scenario with the values of each draw of ``ensemble``."""
    if not document.ensemble:
        return ()
    node = tree.entries["ensemble"]
    mistakes = [
        Mistake(one.name_mark, ("ensemble", key), "is no path in the stack",
                f"a draw changes an option of {', '.join(TWIN_PARTS)}, such as perception.miss_scale")
        for key, one in node.entries.items()
        if key.partition(".")[0] not in TWIN_PARTS or not all(key.split(".")[1:]) or "." not in key
    ]  # fmt: skip
    sizes = {len(values) for values in document.ensemble.values()}
    if len(sizes) > 1 or min(sizes) < _FEWEST_MEMBERS:
        hint = f"each path has a value for every draw, at least {_FEWEST_MEMBERS} of them"
        mistakes.append(
            Mistake(node.name_mark, ("ensemble",), "its lists differ in length or are short", hint)
        )
    if mistakes:
        raise scenario_error(mistakes)
    own = {key: one for key, one in tree.entries.items() if key not in _NOT_OF_MEMBER}
    base = Node(own, tree.mark, tree.key)
    return tuple(_resolve(_member(base, node, k), path, registry) for k in range(min(sizes)))


def _member(base: Node, ensemble: Node, number: int) -> Node:
    for key, draws in ensemble.entries.items():
        value = draws.items[number]
        there = Node(value.value, value.mark, draws.name_mark)
        base = put(base, tuple(key.split(".")), there, draws.name_mark)
    return base


def _without_options(tree: Node) -> Node:
    entries = dict(tree.entries)
    for key in PARTS:
        if key in entries:
            entries[key] = _emptied(entries[key])
    if (specifications := entries.get("specifications")) is not None and specifications.entries:
        emptied = {name: _emptied(node) for name, node in specifications.entries.items()}
        entries["specifications"] = Node(emptied, specifications.mark, specifications.key)
    return Node(entries, tree.mark, tree.key)


def _emptied(node: Node) -> Node:
    return Node({}, node.mark, node.key) if isinstance(node.value, dict) else node


def _resolve_block(
    kind: str, node: Node, path: Path, registry: Registry, folder: str
) -> tuple[Block | None, list[Mistake]]:
    plugin, plugin_path = node.child("plugin"), (*path, "plugin")
    if plugin is None:
        hint = f"installed: {', '.join(registry.names(kind)) or 'none'}"
        return None, [Mistake(node.name_mark, plugin_path, "required, but missing", hint)]
    if not isinstance(plugin.value, str):
        return None, [Mistake(plugin.mark, plugin_path, f"should be a string, found {describe(plugin)}")]
    try:
        row = registry.find(kind, plugin.value)
        model = _options_model(row)
    except PluginError as error:
        return None, [Mistake(plugin.mark, plugin_path, error.message, error.hint, ExitCode.PLUGIN)]
    draws: Draws | None = None
    found: list[Mistake] = []
    if kind == "simulator":
        try:
            node = _completed(row, node, folder)
        except AvrareError as error:
            return None, [Mistake(node.name_mark, path, error.message, error.hint)]
        node, draws, found = find_draws(model, node, path, folder)
    node = _with_files_beside(node, model)
    if refusals := find_refusals(row, model, node, path, folder):
        return None, refusals
    config, mistakes = check(model, node, path, _CORE_KEYS.get(kind, ("plugin",)))
    mistakes += found
    if config is None or row.component is None:
        return None, mistakes
    if linked := find_linked_files(node, path, config, folder):
        return None, [*mistakes, *linked]
    return Block(plugin.value, row.component, config, row.distribution, row.version, draws), mistakes


def _completed(row: Row, node: Node, folder: str) -> Node:
    # With the options that files of others hold.
    if row.component is None or not row.component.complete:
        return node
    beside = os.path.dirname(node.mark.file) if node.mark.line else folder
    found = late_import(row.component.complete)(node.plain(), beside or ".")
    return merge(node, Node.of(found, node.mark))


def _with_files_beside(node: Node, model: type[BaseModel]) -> Node:
    # Files that a scenario names lie beside it; else the path is one from the current folder, as in a run
    # folder, which may hold another file of that name.
    for name in marked_options(model, FILE_OPTION) & node.entries.keys():
        leaf = node.entries[name]
        if isinstance(leaf.value, str) and leaf.mark.line:
            folder, file = os.path.split(leaf.mark.file)
            beside, stored = os.path.join(folder, leaf.value), os.path.join(folder, _RESULT)
            if is_file(beside) and not (file == _STORED and is_file(stored)):
                node = replace(node, value={**node.entries, name: replace(leaf, value=beside)})
    return node


def _options_model(row: Row) -> type[BaseModel]:
    assert row.component is not None
    component = f"{row.kind} {row.name!r} of {row.origin or 'an unknown distribution'}"
    try:
        model = row.component.load_config()
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise PluginError(f"{component} is broken: {reason}", "run `avrare plugins` for details") from None
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        raise PluginError(f"{component} is broken: {row.component.config} is not a pydantic model")
    return model


def _resolve_specification(
    name: str, node: Node, registry: Registry, folder: str, dt: float | None, steps: int | None
) -> tuple[Block | Formula | None, list[Mistake], list[Mistake]]:
    path = ("specifications", name)
    if not isinstance(node.value, dict):
        return None, [], []  # reported by the schema
    if ("stl" in node.value) == ("plugin" in node.value):
        text, hint = "should have either 'stl' or 'plugin'", 'for example {stl: "always (gap > 2.0)"}'
        return None, [Mistake(node.name_mark, path, text, hint)], []
    if "stl" in node.value:
        formula, errors = check(Formula, node, path)
        found = check_formula(formula, node, path, dt, steps) if formula else ([], [])
        return formula, errors + found[0], found[1]
    block, errors = _resolve_block("specification", node, path, registry, folder)
    found = check_block(block, node, path, dt) if block else ([], [])
    return block, errors + found[0], found[1]


def _estimated(tree: Node, known: dict[str, Node]) -> tuple[list[str], list[Mistake]]:
    node = tree.entries_at("estimator").get("specifications")
    if node is None:
        return list(known), []
    path = ("estimator", "specifications")
    if not isinstance(node.value, list) or not node.value:
        text = f"should be a list of specification names, found {describe(node)}"
        return [], [Mistake(node.mark, path, text, "remove the option to estimate all specifications")]
    mistakes = [found for i, item in enumerate(node.value) for found in _check_name(item, (*path, i), known)]
    return [str(item.value) for item in node.value], mistakes


def _check_thresholds(tree: Node, known: dict[str, Node]) -> list[Mistake]:
    thresholds = tree.child("thresholds")
    mistakes: list[Mistake] = []
    for index, item in enumerate(thresholds.items if thresholds else []):
        node = item.child("specification")
        if node is not None and isinstance(node.value, str):
            mistakes += _check_name(node, ("thresholds", index, "specification"), known)
    return mistakes


def _check_other_family(tree: Node, document: Document, estimator: str) -> list[Mistake]:
    check, node = document.cross_check, tree.entries_at("cross_check").get("estimator")
    conflict = check.find_conflict(estimator) if check is not None else None
    if conflict is None or node is None:
        return []
    hint = "leave it out to have one chosen"
    return [Mistake(node.mark, ("cross_check", "estimator"), conflict, hint)]


def _check_name(node: Node, path: Path, known: dict[str, Node]) -> list[Mistake]:
    if isinstance(node.value, str) and node.value in known:
        return []
    word = str(node.value)
    return [Mistake(node.mark, path, f"there is no specification {word!r}", did_you_mean(word, known))]
