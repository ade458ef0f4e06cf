"""Content of catalogue files: scenes with exposures, estimators, budgets and bounds of rates."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from avrare.estimation.plan.budget import Budget
from avrare.scenario.exposure import Exposure, Positive, Unit
from avrare.scenario.schema import OBJECTIVE, ODD, REQUIREMENTS, Probability, Slug


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CatalogueBudget(_Model):
    """Cost of all scenes together."""

    rollouts: int | None = Field(default=None, ge=1, description="rollouts of all scenes, the pilot included")
    steps: float | None = Field(default=None, gt=0.0, description="simulated steps, the pilot included")

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        if (self.rollouts is None) == (self.steps is None):
            raise ValueError("give rollouts or steps")
        return self

    @property
    def budget(self) -> Budget:
        """The same as an estimate takes it."""
        kind = "rollouts" if self.rollouts is not None else "steps"
        return Budget(kind, float(self.rollouts or self.steps or 0.0))


class SceneBudget(CatalogueBudget):
    """Cost of a scene's own estimator."""

    rollouts: int | None = Field(default=None, ge=1, description="rollouts of the scene's own estimator")
    steps: float | None = Field(
        default=None, gt=0.0, description="simulated steps of the scene's own estimator"
    )


class SceneEntry(_Model):
    """Scene of a catalogue."""

    name: Slug = Field(description="name of the scene, and of its folder")
    scenario: str = Field(min_length=1, description="scenario file, relative to the catalogue")
    set: tuple[str, ...] = Field(default=(), description="KEY=VALUE overrides, as after --set")
    exposure: Exposure | None = Field(default=None, description="how often the scene is met")
    cells: int | None = Field(
        default=None,
        ge=1,
        description="cells of a grid that the scene stands for, in place of an exposure: rates are shares of "
        "all cells",
    )
    requirements: tuple[str, ...] = Field(default=(), description=REQUIREMENTS)
    odd: tuple[str, ...] = Field(default=(), description=ODD)
    objective: str | None = Field(default=None, description=OBJECTIVE)
    estimator: str | dict[str, Any] | None = Field(
        default=None,
        description="estimator of a rare scene: a name such as auto, or a block such as {plugin: ams, ...}, "
        "as in scenarios; `scenario`: that of the scenario file; default: a share of the shared rollouts",
    )
    budget: SceneBudget | None = Field(
        default=None,
        description="cost of the scene's own estimator, a fixed part of the catalogue's budget; default: the "
        "estimator's options decide, and its cost comes on top",
    )

    @model_validator(mode="after")
    def _budget_of_an_estimator(self) -> Self:
        if self.budget is not None and self.estimator is None:
            raise ValueError("a scene's budget is that of an estimator of its own: name the estimator")
        return self

    @model_validator(mode="after")
    def _exposure_or_cells(self) -> Self:
        if (self.exposure is None) == (self.cells is None):
            raise ValueError("give the scene's exposure; or, of a grid of scenes, its cells")
        return self

    @property
    def unit(self) -> Unit:
        """Unit that the scene's weight is per."""
        return "cell" if self.exposure is None else self.exposure.unit


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
    per_cell: Bound | None = Field(default=None, description="upper bound of a share of cells")
    blind: Literal["assumed", "counted"] = Field(
        "assumed",
        description="failures that no score leads to: assumed away, as the verdict says, or counted: their "
        "upper bound must lie below the bound, too",
    )

    @model_validator(mode="after")
    def _check_unit(self) -> Self:
        if len(self._bounds) != 1:
            raise ValueError("give one of per_hour, per_km and per_cell")
        return self

    @property
    def _bounds(self) -> dict[Unit, Bound]:
        bounds: dict[Unit, Bound | None] = {"hour": self.per_hour, "km": self.per_km, "cell": self.per_cell}
        return {unit: bound for unit, bound in bounds.items() if bound is not None}

    @property
    def unit(self) -> Unit:
        """Unit that the bounded rate is per."""
        return next(iter(self._bounds))

    @property
    def _words(self) -> list[str]:
        return str(self._bounds[self.unit]).split()

    @property
    def limit(self) -> float:
        """Bound as a number."""
        return float(self._words[1])

    @property
    def strict(self) -> bool:
        """True for ``<``, False for ``<=``."""
        return self._words[0] == "<"

    @property
    def text(self) -> str:
        """Bound as it is shown, such as ``< 0.001 per hour``."""
        return f"{self._words[0]} {self.limit:g} per {self.unit}"


class CatalogueDocument(_Model):
    """Catalogue file."""

    name: Slug = Field(description="name of the catalogue")
    description: str | None = Field(default=None, description="scenes that it stands for")
    scenes: tuple[SceneEntry, ...] = Field(min_length=1, max_length=1000, description="scenes and exposures")
    rules: tuple[str, ...] | None = Field(
        default=None, min_length=1, description="specifications; default: those that all scenes have"
    )
    budget: CatalogueBudget | None = Field(
        default=None, description="cost of all scenes together; required where scenes share it"
    )
    pilot: int = Field(default=100, ge=10, description="rollouts of each scene that only divide the budget")
    speed: Positive | None = Field(
        default=None, description="mean speed of the driving that the exposures are of [km/h]; converts rates"
    )
    confidence: Probability = Field(default=0.95, description="level of the intervals, in (0, 1)")
    seed: int = Field(default=0, ge=0, lt=2**40, description="seed of all random numbers")
    thresholds: tuple[RateThreshold, ...] = Field(default=(), description="bounds that decide the exit code")

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        names = [scene.name for scene in self.scenes]
        if len(set(names)) < len(names):
            raise ValueError("every scene needs a name of its own")
        units = {scene.unit for scene in self.scenes} | {threshold.unit for threshold in self.thresholds}
        if "cell" in units and len(units) > 1:
            raise ValueError(
                "scenes with exposures and cells of a grid are mixed: a share of cells is not a rate"
            )
        if self.speed is None and len(units) > 1:
            raise ValueError("hours and km are mixed: give the mean speed [km/h] that converts them")
        return self
