"""What a scenario may say: ``Document`` checks the file, ``Scenario`` is the result."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, WithJsonSchema, model_validator
from pydantic_core import PydanticCustomError

import avrare
from avrare.errors import UsageError
from avrare.estimation.health import MESSAGES, check_names
from avrare.plugin.component import Component

PARTS = ("simulator", "perception", "tracker", "controller", "estimator")
"""Keys of a scenario that hold one component block each; the key is the kind."""

_SLUG = r"[A-Za-z0-9_][A-Za-z0-9_-]*(\.[A-Za-z0-9_-]+)*"
_BOUND = re.compile(r"\s*(<=|<)?\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*")


def _slug(text: str) -> str:
    if not re.fullmatch(_SLUG, text) or len(text) > 100:
        raise ValueError("a name may hold letters, digits, '_', '-' and inner '.', at most 100 of them")
    return text


def _bound(value: str | float) -> str:
    found = _BOUND.fullmatch(value if isinstance(value, str) else f"< {value!r}")
    if not found or not 0.0 <= float(found[2]) <= 1.0:
        raise ValueError("should be an upper bound between 0 and 1 such as '< 2e-2' or '<= 0.1'")
    return f"{found[1] or '<'} {found[2]}"


Slug = Annotated[
    str, AfterValidator(_slug), WithJsonSchema({"type": "string", "pattern": f"^{_SLUG}$", "maxLength": 100})
]
Probability = Annotated[float, Field(gt=0.0, lt=1.0)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ScoreFormula(_Model):
    """A formula that orders the particles of splitting, and decides nothing."""

    stl: str = Field(description="drives are ordered by how near they have come to failing it")


class Formula(_Model):
    """A specification written as a formula."""

    stl: str = Field(
        description="signal temporal logic over the simulator's signals, e.g. always (gap > 2.0)"
    )
    until: Literal["closed", "half-open"] = Field(
        "closed", description="whether `until` includes the end of its window; half-open is rtamt's reading"
    )
    score: ScoreFormula | str | None = Field(
        None, description="what orders particles: a score's name or {stl: formula}; default by formula shape"
    )


class Threshold(_Model):
    """What the failure probability of a specification must stay below."""

    specification: str = Field(description="name of one of the scenario's specifications")
    probability: Annotated[str | float, AfterValidator(_bound)] = Field(
        description="upper bound such as '< 2e-2' or '<= 0.1'; a plain number means '<'"
    )
    confidence: Probability = Field(0.95, description="of the interval that must lie below the bound, 0 to 1")

    @property
    def limit(self) -> float:
        """The bound itself."""
        return float(str(self.probability).split()[1])

    @property
    def strict(self) -> bool:
        """True for ``<``, False for ``<=``."""
        return str(self.probability).startswith("< ")


class Regression(_Model):
    """How `avrare check` compares with a saved baseline."""

    ratio: float = Field(
        1.0,
        gt=0.0,
        allow_inf_nan=False,
        description="fails when significantly likelier than this many times the baseline",
    )
    exclude: float | None = Field(
        None,
        gt=0.0,
        description="passes when significantly less likely than this many times the baseline; "
        "default: twice `ratio`",
    )
    confidence: Probability = Field(0.95, description="of the comparison, 0 to 1")

    @model_validator(mode="after")
    def _room_between(self) -> Regression:
        if self.exclude is not None and self.exclude <= self.ratio:
            raise ValueError(f"exclude ({self.exclude:g}) must be more than ratio ({self.ratio:g})")
        return self

    @property
    def excluded(self) -> float:
        """``exclude``, or its default."""
        return 2.0 * self.ratio if self.exclude is None else self.exclude


def _suppressible(name: str) -> str:
    try:
        check_names((name,))
    except UsageError as error:
        details = {"message": error.message, "hint": error.hint}
        raise PydanticCustomError("with_hint", "{message}", details) from None
    return name


HealthWarning = Annotated[
    str,
    AfterValidator(_suppressible),
    WithJsonSchema({"type": "string", "enum": [name for name in MESSAGES if name != "errors"]}),
]


class Document(_Model):
    """A scenario file after ``extends`` and overrides; component blocks are checked by their plugins."""

    name: Slug = Field(description="name of the scenario, also of its folder of results")
    description: str | None = Field(None, description="what the scenario shows")
    steps: int = Field(ge=0, le=10_000_000, description="steps of a rollout; 0 is a static problem")
    simulator: dict[str, Any] = Field(description="the world")
    perception: dict[str, Any] | None = Field(None, description="perception error model")
    tracker: dict[str, Any] | None = Field(None, description="tracker and predictor")
    controller: dict[str, Any] | None = Field(None, description="the planner under test")
    specifications: dict[Slug, dict[str, Any]] = Field(
        min_length=1, description="name -> {stl: formula} or {plugin: name, ...}"
    )
    estimator: dict[str, Any] = Field({"plugin": "mc"}, description="how the probability is estimated")
    thresholds: tuple[Threshold, ...] = Field((), description="what `avrare check` decides")
    regression: Regression | None = Field(None, description="how `avrare check` compares with a baseline")
    seed: int = Field(0, ge=0, lt=2**63, description="seed of all random numbers")
    chunk: int = Field(25, ge=1, le=1_000_000, description="rollouts per chunk of work")
    max_error_rate: float = Field(
        0.01, ge=0.0, le=1.0, description="share of rollouts that may end in an error"
    )
    confidence: Probability = Field(0.95, description="of the reported intervals, 0 to 1")
    suppress: tuple[HealthWarning, ...] = Field((), description="names of health warnings to leave out")


@dataclass(frozen=True)
class Block:
    """A component that a scenario names, with its checked options.

    Attributes:
        plugin: Its name.
        component: Its description.
        config: Its options, an instance of the component's own pydantic model.
        distribution: Where it comes from.
        version: Of the distribution.
    """

    plugin: str
    component: Component
    config: Any
    distribution: str = ""
    version: str = ""

    @property
    def resolved(self) -> dict[str, Any]:
        """The block with every default filled in, as plain data."""
        options = self.config.model_dump(mode="json", by_alias=True, warnings=False)
        return {"plugin": self.plugin, **options}


@dataclass(frozen=True)
class Scenario:
    """A checked scenario. Nothing is built yet and nothing heavy is imported.

    Attributes:
        path: The file, as the user wrote it.
        estimated: Names of the specifications that the estimator is asked for, in the scenario's order
            (the estimator option ``specifications``; all of them by default).
        chunk: Rollouts per chunk of work.
        max_error_rate: Share of the rollouts that may end in an error.
        confidence: Of the reported intervals.
        suppress: Names of health warnings to leave out.
        regression: How a check compares with a baseline; None: as by default, if there is one.
        warnings: (message, hint) on specifications that can be used but may not say what is meant.
    """

    path: str = field(compare=False)
    name: str
    steps: int
    simulator: Block
    specifications: Mapping[str, Block | Formula]
    estimator: Block
    estimated: tuple[str, ...]
    perception: Block | None = None
    tracker: Block | None = None
    controller: Block | None = None
    thresholds: tuple[Threshold, ...] = ()
    regression: Regression | None = None
    description: str | None = None
    seed: int = 0
    chunk: int = 25
    max_error_rate: float = 0.01
    confidence: float = 0.95
    suppress: tuple[str, ...] = ()
    warnings: tuple[tuple[str, str | None], ...] = field(default=(), compare=False)

    @property
    def blocks(self) -> dict[str, Block]:
        """Every component block by its dotted path, for instance ``tracker``, ``specifications.safe``."""
        named = {key: getattr(self, key) for key in PARTS}
        named |= {f"specifications.{name}": part for name, part in self.specifications.items()}
        return {key: part for key, part in named.items() if isinstance(part, Block)}

    @property
    def versions(self) -> dict[str, str]:
        """Version of avrare and of every distribution that the scenario uses."""
        used = {part.distribution: part.version for part in self.blocks.values() if part.distribution}
        return dict(sorted({**used, "avrare": avrare.__version__}.items()))

    @property
    def resolved(self) -> dict[str, Any]:
        """The scenario as plain data with every default filled in; loading it gives this scenario again."""
        plain: dict[str, Any] = {"name": self.name, "description": self.description, "steps": self.steps}
        plain |= {key: part.resolved for key in PARTS if (part := getattr(self, key))}
        plain["estimator"] = {**plain["estimator"], "specifications": list(self.estimated)}
        plain["specifications"] = {
            name: part.resolved if isinstance(part, Block) else part.model_dump()
            for name, part in self.specifications.items()
        }
        plain["thresholds"] = [threshold.model_dump() for threshold in self.thresholds]
        if self.regression is not None:
            plain["regression"] = self.regression.model_dump()
        plain |= {key: getattr(self, key) for key in ("seed", "chunk", "max_error_rate", "confidence")}
        plain["suppress"] = list(self.suppress)
        return plain
