"""Catalogues: scenes with exposures, read from YAML with every mistake at its place."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from avrare.base.errors import ScenarioError, UsageError, did_you_mean
from avrare.base.stored_files import open_regular
from avrare.estimation.budget import Budget
from avrare.scenario.exposure import Exposure, Positive, Unit
from avrare.scenario.load import load
from avrare.scenario.safe_mode import TRUST, is_safe, refuse_outside
from avrare.scenario.schema import Probability, Scenario, Slug
from avrare.scenario.validation import Mistake, check, scenario_error
from avrare.scenario.value_positions import Node
from avrare.scenario.yaml import MAX_BYTES, parse


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SceneEntry(_Model):
    """Scene of a catalogue."""

    name: Slug = Field(description="name of the scene, and of its folder")
    scenario: str = Field(min_length=1, description="scenario file, relative to the catalogue")
    set: tuple[str, ...] = Field(default=(), description="KEY=VALUE overrides, as after --set")
    exposure: Exposure = Field(description="how often the scene is met")


class CatalogueBudget(_Model):
    """Cost of all scenes together."""

    rollouts: int | None = Field(default=None, ge=1, description="rollouts of all scenes, the pilot included")
    steps: float | None = Field(default=None, gt=0.0, description="simulated steps, the pilot included")

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.rollouts is None) == (self.steps is None):
            raise ValueError("give rollouts or steps")
        return self


def _positive_bound(value: str | float) -> str:
    text = value if isinstance(value, str) else f"< {value!r}"
    sign = "<=" if text.strip().startswith("<=") else "<"
    try:
        number = float(text.strip().removeprefix(sign))
    except ValueError:
        number = -1.0
    if not 0.0 < number < float("inf"):
        raise ValueError("should be an upper bound above 0 such as '< 1e-3'")
    return f"{sign} {number!r}"


Bound = Annotated[str | float, AfterValidator(_positive_bound)]


class RateThreshold(_Model):
    """Upper bound on the rate of a rule."""

    rule: str = Field(description="name of a specification of the scenes")
    per_hour: Bound | None = Field(default=None, description="upper bound such as '< 1e-3'")
    per_km: Bound | None = Field(default=None, description="upper bound such as '< 1e-5'")

    @model_validator(mode="after")
    def _one_unit(self) -> Self:
        if (self.per_hour is None) == (self.per_km is None):
            raise ValueError("give per_hour or per_km")
        return self

    @property
    def unit(self) -> Unit:
        """Unit that the bounded rate is per."""
        return "hour" if self.per_hour is not None else "km"

    @property
    def limit(self) -> float:
        """Bound as a number."""
        return float(str(self.per_hour or self.per_km).split()[1])

    @property
    def text(self) -> str:
        """Bound as it is shown, such as ``< 0.001 per hour``."""
        sign = str(self.per_hour or self.per_km).split()[0]
        return f"{sign} {self.limit:g} per {self.unit}"


class CatalogueDocument(_Model):
    """Catalogue file."""

    name: Slug = Field(description="name of the catalogue")
    description: str | None = Field(default=None, description="what it stands for")
    scenes: tuple[SceneEntry, ...] = Field(min_length=1, max_length=1000, description="scenes and exposures")
    rules: tuple[str, ...] | None = Field(
        default=None, min_length=1, description="specifications; default: those that all scenes have"
    )
    budget: CatalogueBudget = Field(description="cost of all scenes together")
    pilot: int = Field(default=100, ge=10, description="rollouts of each scene that only divide the budget")
    speed: Positive | None = Field(
        default=None, description="mean speed of the driving that the exposures are of [km/h]; converts rates"
    )
    confidence: Probability = Field(default=0.95, description="level of the intervals, in (0, 1)")
    seed: int = Field(default=0, ge=0, lt=2**40, description="seed of all random numbers")
    thresholds: tuple[RateThreshold, ...] = Field(default=(), description="bounds that decide the exit code")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [scene.name for scene in self.scenes]
        if len(set(names)) < len(names):
            raise ValueError("every scene needs a name of its own")
        units = {scene.exposure.unit for scene in self.scenes} | {one.unit for one in self.thresholds}
        if self.speed is None and len(units) > 1:
            raise ValueError("hours and km are mixed: give the mean speed [km/h] that converts them")
        return self


@dataclass(frozen=True)
class Catalogue:
    """Checked catalogue; no scene is built.

    Attributes:
        path: File, as the user wrote it.
        document: Its content.
        rules: Specifications that are estimated.
    """

    path: str
    document: CatalogueDocument
    rules: tuple[str, ...]

    def scenario(self, index: int, phase: Literal["pilot", "scenes"], rollouts: int) -> Scenario:
        """Return the scenario of a scene, to be estimated by Monte Carlo with a seed of its own."""
        entry = self.document.scenes[index]
        seed = 2048 * self.document.seed + 2 * index + (phase == "pilot")
        settings = [
            *entry.set,
            f"name={entry.name}",
            f"seed={seed}",
            f"estimator.rollouts={rollouts}",
            f"estimator.specifications=[{', '.join(self.rules)}]",
            f"confidence={self.document.confidence}",
            "cross_check=false",
            "thresholds=[]",
            f"exposure={entry.exposure.model_dump_json(exclude_none=True)}",
        ]
        return load(_path(self.path, entry), settings, "mc")

    def budget(self, given: Budget | None) -> Budget:
        """Return the budget: the given one, else the file's."""
        if given is not None and given.kind == "seconds":
            raise UsageError(
                "a catalogue's budget is in rollouts or steps", "seconds would change the result"
            )
        own = self.document.budget
        kind = "rollouts" if own.rollouts is not None else "steps"
        return given or Budget(kind, float(own.rollouts or own.steps or 0.0))


def load_catalogue(path: str) -> Catalogue:
    """Read a catalogue and check it and all its scenes.

    Raises:
        ScenarioError: The file or a scene has mistakes; the message has all of those found, with places.
    """
    try:
        with open_regular(path) as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a pipe, or a NUL in the path
        reason = (error.strerror or str(error)).lower() if isinstance(error, OSError) else error
        raise UsageError(f"{path}: cannot be read: {reason}") from None
    tree = parse(data, path, "catalogue", "a catalogue needs name, scenes and budget")
    document, mistakes = check(CatalogueDocument, tree)
    if document is None:
        raise scenario_error(mistakes)
    scenes = tree.entries["scenes"].items
    names = [_specifications(path, *pair) for pair in zip(document.scenes, scenes, strict=True)]
    common = [name for name in names[0] if all(name in other for other in names)]
    rules = tuple(document.rules or common)
    if not rules:
        text = "the scenes have no specification in common"
        raise tree.entries["scenes"].name_mark.error(f"scenes: {text}", "name them alike in all scenarios")
    mistakes = _check_rules(tree, document, rules, names)
    if mistakes:
        raise scenario_error(mistakes)
    return Catalogue(path, document, rules)


def _path(catalogue: str, entry: SceneEntry) -> str:
    folder = os.path.dirname(catalogue)
    path = os.path.normpath(os.path.join(folder, entry.scenario))
    refuse_outside(path, folder or ".", "the scenario")
    if is_safe() and entry.set:  # overrides count as the user's own and are not looked into
        raise UsageError(f"safe mode: scene {entry.name!r} overrides options of its scenario", TRUST)
    return path


def _specifications(path: str, entry: SceneEntry, node: Node) -> list[str]:
    try:
        return list(load(_path(path, entry), entry.set, "mc").specifications)
    except ScenarioError as error:
        place = node.entries["scenario"].mark
        raise ScenarioError(
            [(f"{place}: scenes: {entry.name}: this scenario has mistakes:", None), *error.problems],
            error.exit_code,
        ) from None


def _check_rules(
    tree: Node, document: CatalogueDocument, rules: tuple[str, ...], names: list[list[str]]
) -> list[Mistake]:
    mistakes = []
    for index, rule in enumerate(document.rules or ()):
        for scene, known in zip(document.scenes, names, strict=True):
            if rule not in known:
                node = tree.entries["rules"].items[index]
                text = f"scene {scene.name!r} has no specification {rule!r}"
                mistakes.append(Mistake(node.mark, ("rules", index), text, did_you_mean(rule, known)))
                break
    for index, threshold in enumerate(document.thresholds):
        if threshold.rule not in rules:
            node = tree.entries["thresholds"].items[index].entries["rule"]
            text, hint = f"no rate of {threshold.rule!r} is estimated", did_you_mean(threshold.rule, rules)
            mistakes.append(Mistake(node.mark, ("thresholds", index, "rule"), text, hint))
    return mistakes
