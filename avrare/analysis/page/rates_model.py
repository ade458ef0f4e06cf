"""Values that make the page of a catalogue's rates; see ``model``."""

from __future__ import annotations

from dataclasses import dataclass

from avrare.analysis.page.model import StoredModel
from avrare.base.chart import Scale


@dataclass(frozen=True)
class Rate:
    """Rate of a rule in one unit, with its intervals; ``verdicts`` have the words of their thresholds."""

    rule: str
    unit: str
    value: float
    interval: tuple[float, float]
    sampling: tuple[float, float]
    exposure: tuple[float, float]
    verdicts: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class SceneShare:
    """Part of a scene in a rate and in its interval; ``estimator`` is empty where counts are all."""

    scene: str
    failures: int
    rollouts: int
    probability: float
    estimator: str
    share: float
    doubt: float


@dataclass(frozen=True)
class RuleScenes:
    """Scenes of a rule, those that contribute most first."""

    rule: str
    sentence: str
    scenes: tuple[SceneShare, ...]


@dataclass(frozen=True)
class OwnEstimate:
    """Estimate of a rule by a scene's own estimator, with the names of its warnings."""

    scene: str
    rule: str
    estimator: str
    probability: float
    interval: tuple[float, float]
    rollouts: int
    steps: int
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class SceneExposure:
    """How often a scene is met, and its rollouts."""

    scene: str
    scenario: str
    value: float
    interval: tuple[float, float]
    unit: str
    rollouts: int


@dataclass(frozen=True)
class RatesModel(StoredModel):
    """Everything that the page of a catalogue's rates shows.

    Attributes:
        name: Name of the catalogue.
        description: What it says of itself.
        rollouts: Rollouts of all scenes.
        seed: Seed.
        confidence: Level of the intervals.
        speed: Speed at which hours and km are converted [km/h]; None where they are not.
        errors: Scenes with more errors than they allow.
        warnings: Lines on warned estimates.
        axes: Axis of the intervals of each unit.
        rates: Rates of the rules.
        rules: Scenes of each rule.
        own: Estimates with intervals of their own.
        blind: Lines on failures that the rates may leave out.
        scenes: All scenes.
    """

    name: str
    description: str
    rollouts: int
    seed: int
    confidence: float
    speed: float | None
    errors: tuple[str, ...]
    warnings: tuple[str, ...]
    axes: dict[str, Scale]
    rates: tuple[Rate, ...]
    rules: tuple[RuleScenes, ...]
    own: tuple[OwnEstimate, ...]
    blind: tuple[str, ...]
    scenes: tuple[SceneExposure, ...]
