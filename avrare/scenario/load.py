"""Scenarios from files: read, extended, overridden, validated; one, or all of a command."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import PurePath
from pkgutil import resolve_name

from pydantic import BaseModel

from avrare.base.errors import (
    AvrareError,
    ExitCode,
    PluginError,
    ScenarioError,
    UsageError,
    did_you_mean,
    require_path,
)
from avrare.base.stored_files import open_regular
from avrare.plugin.component import Component
from avrare.plugin.first_party import TWIN_ESTIMATOR
from avrare.plugin.options import FILE, Options
from avrare.plugin.registry import Registry, Row, default_registry
from avrare.scenario.draws import check_drawn
from avrare.scenario.fingerprint import is_file
from avrare.scenario.overrides import override, read_extended
from avrare.scenario.safe_mode import check_import_path, find_linked_files, find_refusals
from avrare.scenario.schema import PARTS, TWIN_PARTS, Block, Document, Formula, Scenario
from avrare.scenario.specification_checks import check_specification, step_of
from avrare.scenario.timing import Timing
from avrare.scenario.validation import Mistake, check, describe, find_places, scenario_error
from avrare.scenario.value_positions import Mark, Node, Path, merge, put
from avrare.scenario.yaml import MAX_BYTES, parse

_SETTINGS = tuple(key for key in Document.model_fields if key not in (*PARTS, "specifications", "cheap"))
_NOT_OF_MEMBER = ("ensemble", "thresholds", "regression", "cross_check")
_STORED, _RESULT = "scenario.yaml", "result.json"
"""Files that mark a run folder: its scenario and its result."""


def load(
    path: str | os.PathLike[str],
    overrides: Sequence[str] = (),
    estimator: str | Node | None = None,
    registry: Registry | None = None,
) -> Scenario:
    """Load and check a scenario; builds nothing and imports nothing heavy.

    The defaults of ``estimator``, or a block that another file has for it, replace the file's estimator
    block; ``overrides``, ``KEY=VALUE`` as after ``--set``, are applied last. The error has all mistakes, each
    with its place. In safe mode (``avrare.scenario.safe_mode``) they include all that an untrusted scenario
    may not name.
    """
    hint = "give its path; a Problem is for avrare.estimate, compare, falsify and trace"
    file = require_path(path, "a scenario file", hint)
    check_import_path(os.path.dirname(file) or ".")
    tree = override(_with_estimator(read_extended(file), estimator), overrides)
    return _resolve(tree, file, registry or default_registry())


def check_estimator(node: Node, path: Path, folder: str) -> list[Mistake]:
    """List the mistakes in an estimator's block that stands at a path of a file in ``folder``."""
    return _resolve_block("estimator", node, path, default_registry(), folder)[1]


def _with_estimator(tree: Node, chosen: str | Node | None) -> Node:
    written = tree.child("estimator")
    if chosen is None and written is not None and written.value is not None:
        return tree
    if not isinstance(chosen, Node):
        mark = tree.mark if chosen is None else Mark("--estimator")
        default = TWIN_ESTIMATOR if tree.entries_at("cheap") else "auto"
        chosen = Node.of({"plugin": default if chosen is None else chosen}, mark)
    return Node({**tree.entries, "estimator": chosen}, tree.mark, tree.key)


def _resolve(tree: Node, path: str, registry: Registry) -> Scenario:
    folder = os.path.dirname(path) or "."
    # 1. The core's own keys; the options of the parts are left to their plugins' models.
    document, mistakes = check(Document, tree)
    # 2. The parts.
    blocks: dict[str, Block] = {}
    for kind in PARTS:
        node = tree.child(kind)
        if node is not None and isinstance(node.value, dict):
            block, errors = _resolve_block(kind, node, (kind,), registry, folder)
            mistakes += errors
            if block is not None:
                blocks[kind] = block
    # 3. The specifications, and what refers to them.
    specifications: dict[str, Block | Formula] = {}
    warnings: list[Mistake] = []
    dt, steps = step_of(blocks.get("simulator")), document.steps if document else None
    written = tree.entries_at("specifications")
    for name, node in written.items():
        specification, errors, doubts = _resolve_specification(name, node, registry, folder, dt, steps)
        mistakes += errors
        warnings += doubts
        if specification is not None:
            specifications[name] = specification
    if document is not None:
        errors, doubts = check_timing(document.timing, tree.child("timing"), dt, steps)
        mistakes += errors
        warnings += doubts
    mistakes += _check_references(tree, written)
    if document is not None and "estimator" in blocks:
        mistakes += _check_other_family(tree, document, blocks["estimator"].plugin)
    if mistakes or document is None:
        raise scenario_error(mistakes)
    # 4. The same scenario with other parts or options.
    chosen = tree.entries_at("estimator").get("specifications")
    names = written if chosen is None else [node.value for node in chosen.items]
    return Scenario(
        path=path,
        simulator=blocks["simulator"],
        perception=blocks.get("perception"),
        tracker=blocks.get("tracker"),
        controller=blocks.get("controller"),
        estimator=blocks["estimator"],
        specifications=specifications,
        estimated=tuple(name for name in specifications if name in names),
        cheap=_resolve_twin(tree, path, registry),
        cheap_cost=document.cheap.cost if document.cheap is not None else None,
        members=_resolve_members(tree, document, path, registry),
        warnings=tuple((warning.message, warning.hint) for warning in warnings),
        **{key: getattr(document, key) for key in _SETTINGS},
    )


def _resolve_twin(tree: Node, path: str, registry: Registry) -> Scenario | None:
    """Return the scenario whose parts are those of ``cheap``, merged over this one's."""
    cheap = tree.entries_at("cheap")
    if not cheap:
        return None
    parts = Node({key: node for key, node in cheap.items() if key in TWIN_PARTS}, tree.mark)
    return _resolve(merge(tree.without(("cheap", *_NOT_OF_MEMBER)), parts), path, registry)


def _resolve_members(tree: Node, document: Document, path: str, registry: Registry) -> tuple[Scenario, ...]:
    """Return the scenario with the values of each draw of ``ensemble``."""
    if not document.ensemble:
        return ()
    ensemble = tree.entries["ensemble"]
    mistakes = []
    for key, values in ensemble.entries.items():
        part, *options = key.split(".")
        if part not in TWIN_PARTS or not options or not all(options):
            hint = f"a draw changes an option of {', '.join(TWIN_PARTS)}, such as perception.miss_scale"
            text = "is not a path in the stack"
            mistakes.append(Mistake(values.name_mark, ("ensemble", key), text, hint))
    sizes = {len(values) for values in document.ensemble.values()}
    fewest = 3
    if len(sizes) > 1 or min(sizes) < fewest:
        hint = f"each path has a value for every draw, at least {fewest} of them"
        text = "its lists differ in length or are short"
        mistakes.append(Mistake(ensemble.name_mark, ("ensemble",), text, hint))
    if mistakes:
        raise scenario_error(mistakes)
    members = []
    for number in range(min(sizes)):
        member = tree.without(_NOT_OF_MEMBER)
        for key, values in ensemble.entries.items():
            value = replace(values.items[number], key=values.name_mark)
            member = put(member, tuple(key.split(".")), value, values.name_mark)
        members.append(_resolve(member, path, registry))
    return tuple(members)


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
        component, model = _load_model(row)
    except PluginError as error:
        return None, [Mistake(plugin.mark, plugin_path, error.message, error.hint, ExitCode.PLUGIN)]
    node = _find_files(node, model)
    if component.complete:  # some of its options are in files of others
        directory = os.path.dirname(node.mark.file) if node.mark.line else folder
        try:
            options = resolve_name(component.complete)(node.plain(), directory or ".")
        except AvrareError as error:
            return None, [Mistake(node.name_mark, path, error.message, error.hint)]
        node = merge(node, Node.of(options, node.mark))
    if refusals := find_refusals(row, model, node, path, folder):
        return None, refusals
    if kind == "simulator":
        config, draws, mistakes = check_drawn(model, node, path, folder)
    else:
        core_keys = ("plugin", "specifications") if kind == "estimator" else ("plugin",)
        config, mistakes = check(model, node, path, core_keys)
        draws = None
    linked = find_linked_files(node, path, config, folder)
    if config is None or linked:
        return None, [*mistakes, *linked]
    return Block(plugin.value, component, config, row.distribution, row.version, draws), mistakes


def _load_model(row: Row) -> tuple[Component, type[Options]]:
    assert row.component is not None
    try:
        return row.component, row.component.load_config()
    except (Exception, SystemExit) as error:
        component = f"{row.kind} {row.name!r} of {row.origin or 'an unknown distribution'}"
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise PluginError(f"{component} is broken: {reason}", "run `avrare plugins` for details") from None


def _find_files(node: Node, model: type[BaseModel]) -> Node:
    # A file lies beside the scenario or below the current folder. A run folder, which may hold another of
    # that name, has the paths of the folder that its command ran in: of the current one, or of one above it.
    for at, place in find_places(model, node).items():
        value, mark = place.node.value, place.node.mark
        if place.is_marked(FILE) and isinstance(value, str) and mark.line:
            folder, file = os.path.split(mark.file)
            finished = file == _STORED and is_file(os.path.join(folder, _RESULT))
            above = PurePath(os.path.abspath(folder)).parents if finished else ()
            paths = [value] if finished else [os.path.join(folder, value), value]
            paths += [os.path.join(directory, value) for directory in above]
            node = node.replace(at, next(filter(is_file, paths), value))
    return node


def _resolve_specification(
    name: str, node: Node, registry: Registry, folder: str, dt: float | None, steps: int | None
) -> tuple[Block | Formula | None, list[Mistake], list[Mistake]]:
    path = ("specifications", name)
    if not isinstance(node.value, dict):
        return None, [], []  # reported by the schema
    if ("stl" in node.value) == ("plugin" in node.value):
        text, hint = "should have either 'stl' or 'plugin'", 'for example {stl: "always (gap > 2.0)"}'
        return None, [Mistake(node.name_mark, path, text, hint)], []
    specification: Block | Formula | None
    if "stl" in node.value:
        specification, mistakes = check(Formula, node, path)
    else:
        specification, mistakes = _resolve_block("specification", node, path, registry, folder)
    if specification is None:
        return None, mistakes, []
    errors, warnings = check_specification(specification, node, path, dt, steps)
    return specification, mistakes + errors, warnings


def _check_references(tree: Node, specifications: Collection[str]) -> list[Mistake]:
    """Check the names of specifications in the estimator's list and in thresholds."""
    mistakes: list[Mistake] = []
    names: dict[Path, Node] = {}
    if (chosen := tree.entries_at("estimator").get("specifications")) is not None:
        path: Path = ("estimator", "specifications")
        if not chosen.items:
            text = f"should be a list of specification names, found {describe(chosen)}"
            mistakes.append(
                Mistake(chosen.mark, path, text, "remove the option to estimate all specifications")
            )
        names |= {(*path, number): node for number, node in enumerate(chosen.items)}
    thresholds = tree.child("thresholds")
    for number, threshold in enumerate(thresholds.items if thresholds is not None else ()):
        node = threshold.child("specification")
        if node is not None and isinstance(node.value, str):
            names["thresholds", number, "specification"] = node
    for at, node in names.items():
        if not isinstance(node.value, str):
            text = f"should be the name of a specification, found {describe(node)}"
            mistakes.append(Mistake(node.mark, at, text, did_you_mean("", specifications)))
        elif node.value not in specifications:
            text, hint = f"unknown specification {node.value!r}", did_you_mean(node.value, specifications)
            mistakes.append(Mistake(node.mark, at, text, hint))
    return mistakes


def _check_other_family(tree: Node, document: Document, estimator: str) -> list[Mistake]:
    check, node = document.cross_check, tree.entries_at("cross_check").get("estimator")
    conflict = check.find_conflict(estimator) if check is not None else None
    if conflict is None or node is None:
        return []
    hint = "leave it out to have one chosen"
    return [Mistake(node.mark, ("cross_check", "estimator"), conflict, hint)]


def load_scenarios(
    paths: Sequence[str | os.PathLike[str]], overrides: Sequence[str] = (), estimator: str | None = None
) -> list[Scenario]:
    """Load scenario files, which must have different names.

    Raises:
        ScenarioError: A file has mistakes.
        UsageError: A file is a catalogue, or two scenarios have the same name.
    """
    try:
        scenarios = [load(path, overrides, estimator) for path in paths]
    except ScenarioError:
        for path in (path for path in paths if is_catalogue(path)):
            text = f"{path}: is a catalogue of scenes, and no scenario"
            raise UsageError(text, f"avrare rate {path}, or with thresholds avrare check {path}") from None
        raise
    names = sorted(scenario.name for scenario in scenarios)
    if len(set(names)) < len(names):
        raise UsageError(f"two scenarios have the same name: {', '.join(names)}", "give one per command")
    return scenarios


def is_catalogue(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a list of scenes; one that cannot be read is none."""
    name = require_path(path, "a scenario file")
    try:
        with open_regular(name) as file:
            top = parse(file.read(MAX_BYTES), name)
    except (AvrareError, OSError, ValueError):
        return False
    return top.child("scenes") is not None and top.child("simulator") is None


_CONSEQUENCES = {
    "sensor_period": "it has a single frame",
    "tracker_period": "the tracker is updated once",
    "planner_period": "it has a single plan",
    "perception_latency": "none of its frames is ever read",
    "planning_latency": "none of its plans takes effect",
    "actuation_delay": "none of its commands takes effect",
}
"""Effect of a time that is as long as the drive."""


def check_timing(
    timing: Timing | None, node: Node | None, dt: float | None, steps: int | None
) -> tuple[list[Mistake], list[Mistake]]:
    """Return errors and warnings of the block ``timing``; ``dt`` [s] and ``steps`` may be unknown."""
    if timing is None or node is None or dt is None:
        return [], []

    def place(name: str, text: str, hint: str | None = None) -> Mistake:
        options = node.child(name)
        return Mistake(node.name_mark if options is None else options.mark, ("timing", name), text, hint)

    errors = [place(name, error.message, error.hint) for name, error in timing.find_faults(dt).items()]
    duration, options = (steps or 0) * dt, timing.model_dump(exclude_none=True)
    late = [name for name in _CONSEQUENCES if options.get(name, 0.0) >= duration > 0.0]
    warnings = [
        place(
            name, f"{options[name]:g} s is not shorter than the drive, {duration:g} s: {_CONSEQUENCES[name]}"
        )
        for name in late
    ]
    return errors, warnings
