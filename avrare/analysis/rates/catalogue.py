"""Catalogues: scenes with exposures, read from YAML with every mistake at its place."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from avrare.analysis.rates.catalogue_document import CatalogueDocument, SceneEntry
from avrare.base.errors import ScenarioError, UsageError, did_you_mean, require_path
from avrare.base.stored_files import open_regular
from avrare.estimation.plan.budget import Budget
from avrare.plugin.registry import default_registry
from avrare.scenario.load import check_estimator, load
from avrare.scenario.overrides import read_driver
from avrare.scenario.safe_mode import TRUST, is_safe, refuse_outside
from avrare.scenario.schema import Scenario
from avrare.scenario.validation import Mistake, check, scenario_error
from avrare.scenario.value_positions import Node
from avrare.scenario.yaml import MAX_BYTES, parse

FROM_FILE = "scenario"
"""Estimator of a scene that replaces that of its scenario file."""

Phase = Literal["own", "pilot", "scenes"]


@dataclass(frozen=True)
class Catalogue:
    """Checked catalogue; no scene is built.

    Attributes:
        path: File, as the user wrote it.
        document: Its content.
        rules: Specifications that are estimated.
        own_rules: Of each scene, the rules that an estimator of its own estimates.
        blocks: Of each scene, the estimator as it is written in the catalogue; None: it is not.
        driver: Settings of all scenes that let another controller drive, in place of the stack's.
    """

    path: str
    document: CatalogueDocument
    rules: tuple[str, ...]
    own_rules: tuple[tuple[str, ...], ...]
    blocks: tuple[Node | None, ...] = field(compare=False)
    driver: tuple[str, ...] = ()

    def drive_by(self, text: str) -> Catalogue:
        """Return the catalogue with the controller that ``CONTROLLER=MODEL`` names in place of the stack's.

        Raises:
            UsageError: The text names none.
        """
        settings = read_driver(text)
        if not settings:
            hint = "write CONTROLLER=MODEL, such as reference_driver=fsm"
            raise UsageError(f"--against {text}: only a controller can drive a catalogue's scenes", hint)
        return replace(self, driver=tuple(settings))

    def list_shared_rules(self, index: int) -> tuple[str, ...]:
        """Return the rules of a scene that are estimated by a share of the Monte Carlo rollouts."""
        return tuple(rule for rule in self.rules if rule not in self.own_rules[index])

    def scenario(self, index: int, phase: Phase, rollouts: int) -> Scenario:
        """Return the scenario of a scene in a phase, with its own seed.

        In the phases ``pilot`` and ``scenes`` Monte Carlo estimates it by ``rollouts`` rollouts.
        """
        entry = self.document.scenes[index]
        seed = 2048 * self.document.seed + 2 * index + (phase == "pilot")
        rules = self.own_rules[index] if phase == "own" else self.list_shared_rules(index)
        common = [
            f"estimator.specifications=[{', '.join(rules)}]",
            f"confidence={self.document.confidence}",
            "thresholds=[]",
            f"exposure={entry.exposure.model_dump_json(exclude_none=True) if entry.exposure else 'null'}",
        ]
        tags = entry.model_dump(include={"requirements", "odd", "objective"}, exclude_defaults=True)
        common += [f"{key}={json.dumps(value)}" for key, value in tags.items()]
        named = [*self.driver, f"name={entry.name}", f"seed={seed}"]
        if phase == "own":
            return load(_path(self.path, entry), [*entry.set, *named, *common], self.blocks[index])
        plain = [f"estimator.rollouts={rollouts}", "cross_check=false"]
        plain += ["ensemble={}"] if phase == "pilot" else []  # what members say divides no budget
        return load(_path(self.path, entry), [*_plain(entry), *named, *plain, *common], "mc")

    def own_estimator_budget(self, index: int) -> Budget | None:
        """Return the budget of each estimate of a scene's own estimator, None where its options decide."""
        entry = self.document.scenes[index]
        if entry.budget is None:
            return None
        whole = entry.budget.budget
        name = self.scenario(index, "own", 0).estimator.plugin
        shared = default_registry().get("estimator", name).shares_rollouts
        parts = 1 if shared else len(self.own_rules[index])
        return Budget(whole.kind, whole.amount / parts)

    def own_estimators_cost(self, kind: str, steps: Sequence[int]) -> float:
        """Return the rollouts or steps that the scenes take from the budget of the catalogue."""
        taken = []
        for entry, count in zip(self.document.scenes, steps, strict=True):
            if entry.budget is not None:
                budget, whole = entry.budget.budget, float(max(count, 1))
                scale = 1.0 if budget.kind == kind else whole if kind == "steps" else 1.0 / whole
                taken.append(budget.amount * scale)
        return math.fsum(taken)

    def budget(self, given: Budget | None) -> Budget | None:
        """Return the budget: the given one, else the file's; None where no scene shares one."""
        if given is not None and given.kind == "seconds":
            raise UsageError(
                "a catalogue's budget is in rollouts or steps", "seconds would change the result"
            )
        if not any(map(self.list_shared_rules, range(len(self.document.scenes)))):
            if given is not None:
                text = "no scene shares a budget: each has an estimator of its own"
                raise UsageError(text, "give the scenes in the catalogue a budget")
            return None
        stated = self.document.budget
        return given or (stated.budget if stated is not None else None)


def load_catalogue(source: str | os.PathLike[str]) -> Catalogue:
    """Read a catalogue and check it and all its scenes.

    Raises:
        ScenarioError: The file or a scene has mistakes; the message has all of those found, with places.
    """
    path = require_path(source, "a catalogue")
    try:
        with open_regular(path) as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a pipe, or a NUL in the path
        reason = (error.strerror or str(error)).lower() if isinstance(error, OSError) else error
        raise UsageError(f"{path}: cannot be read: {reason}", "give the file of a catalogue") from None
    tree = parse(data, path, "catalogue", "a catalogue needs name, scenes and budget")
    document, mistakes = check(CatalogueDocument, tree)
    if document is None:
        raise scenario_error(mistakes)
    scenes = tree.entries["scenes"].items
    blocks = [_block(node) for node in scenes]
    mistakes = [
        mistake for k, block in enumerate(blocks) for mistake in _check_block(scenes[k], block, k, path)
    ]
    if mistakes:
        raise scenario_error(mistakes)
    names = [_specifications(path, *pair) for pair in zip(document.scenes, scenes, strict=True)]
    common = [name for name in names[0] if all(name in other for other in names)]
    rules = tuple(document.rules or common)
    if not rules:
        text = "the scenes have no specification in common"
        raise tree.entries["scenes"].name_mark.error(f"scenes: {text}", "name them alike in all scenarios")
    mistakes = _check_rules(tree, document, rules, names)
    if mistakes:
        raise scenario_error(mistakes)
    served = zip(document.scenes, scenes, blocks, range(len(scenes)), strict=True)
    own_rules = tuple(_own_rules(path, *scene, rules) for scene in served)
    if document.budget is None and any(set(rules) - set(names) for names in own_rules):
        hint = "budget: cost of all scenes together, such as {rollouts: 2000}"
        raise scenario_error([Mistake(tree.mark, ("budget",), "required, but missing", hint)])
    return Catalogue(path, document, rules, own_rules, tuple(blocks))


def _path(catalogue: str, entry: SceneEntry) -> str:
    folder = os.path.dirname(catalogue)
    path = os.path.normpath(os.path.join(folder, entry.scenario))
    refuse_outside(path, folder or ".", "the scenario")
    if is_safe() and entry.set:  # overrides count as the user's own and are not looked into
        raise UsageError(f"safe mode: scene {entry.name!r} overrides options of its scenario", TRUST)
    return path


def _plain(entry: SceneEntry) -> list[str]:
    # Options of the scene's own estimator are not those of Monte Carlo.
    if entry.estimator is None:
        return list(entry.set)
    return [
        setting
        for setting in entry.set
        if setting.strip().partition("=")[0].split(".")[0].strip() != "estimator"
    ]


def _block(scene: Node) -> Node | None:
    node = scene.entries.get("estimator")
    if node is None or node.value is None or node.value == FROM_FILE:
        return None
    return Node({"plugin": node}, node.mark, node.key) if isinstance(node.value, str) else node


def _check_block(scene: Node, block: Node | None, index: int, path: str) -> list[Mistake]:
    if block is None:
        return []
    place, entry = ("scenes", index, "estimator"), scene.entries["estimator"].value
    mistakes = check_estimator(block, place, os.path.dirname(path) or ".")
    if not isinstance(entry, str):
        return mistakes
    near = did_you_mean(entry, [FROM_FILE])
    near_hint = near if near is not None and near.startswith("did you mean") else None
    return [replace(mistake, path=place, hint=near_hint or mistake.hint) for mistake in mistakes]


def _specifications(path: str, entry: SceneEntry, node: Node) -> list[str]:
    return list(_load(path, entry, node, _plain(entry), "mc").specifications)


def _load(
    path: str, entry: SceneEntry, node: Node, settings: Sequence[str], estimator: str | Node | None
) -> Scenario:
    try:
        return load(_path(path, entry), settings, estimator)
    except ScenarioError as error:
        place = node.entries["scenario"].mark
        raise ScenarioError(
            [(f"{place}: scenes: {entry.name}: this scenario has mistakes:", None), *error.problems],
            error.exit_code,
        ) from None


def _own_rules(
    path: str, entry: SceneEntry, node: Node, block: Node | None, index: int, rules: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the rules that the estimator of the scene estimates."""
    if entry.estimator is None:
        return ()
    options = {} if block is None else block.entries
    if (named := options.get("specifications")) is not None:
        mistakes = [
            Mistake(
                rule_node.mark,
                ("scenes", index, "estimator", "specifications", k),
                f"no rate of {rule_node.value!r} is estimated",
                did_you_mean(str(rule_node.value), rules),
            )
            for k, rule_node in enumerate(named.items)
            if rule_node.value not in rules
        ]
        if mistakes:
            raise scenario_error(mistakes)
    estimated = _load(path, entry, node, entry.set, block).estimated
    served = tuple(rule for rule in rules if rule in estimated)
    if not served:
        mark, place = node.entries["estimator"].mark, ("scenes", index, "estimator")
        text, hint = "it estimates no rule of the catalogue", f"these are {', '.join(rules)}"
        raise scenario_error([Mistake(mark, place, text, hint)])
    return served


def _check_rules(
    tree: Node, document: CatalogueDocument, rules: tuple[str, ...], names: list[list[str]]
) -> list[Mistake]:
    mistakes = []
    for index, rule in enumerate(document.rules or ()):
        for scene, specifications in zip(document.scenes, names, strict=True):
            if rule not in specifications:
                node = tree.entries["rules"].items[index]
                text = f"scene {scene.name!r} has no specification {rule!r}"
                hint = did_you_mean(rule, specifications)
                mistakes.append(Mistake(node.mark, ("rules", index), text, hint))
                break
    for index, threshold in enumerate(document.thresholds):
        if threshold.rule not in rules:
            node = tree.entries["thresholds"].items[index].entries["rule"]
            text, hint = f"no rate of {threshold.rule!r} is estimated", did_you_mean(threshold.rule, rules)
            mistakes.append(Mistake(node.mark, ("thresholds", index, "rule"), text, hint))
    return mistakes
