"""Schema of scenarios: ``Document`` checks the file, ``Scenario`` is the result."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    WithJsonSchema,
    model_validator,
)

from avrare.base import version
from avrare.base.errors import UsageError
from avrare.plugin.component import Component
from avrare.plugin.options import Options
from avrare.plugin.registry import default_registry
from avrare.scenario.cross_check import CrossCheck, as_cross_check
from avrare.scenario.draws import Draws
from avrare.scenario.exposure import Exposure
from avrare.scenario.timing import Actuators, Aeb, Timing
from avrare.scenario.validation import error_with_hint

PARTS = ("simulator", "perception", "tracker", "controller", "estimator")
"""Keys of a scenario that hold one component block each; the key is the component's kind."""
TWIN_PARTS = PARTS[:-1]
"""Parts of the stack in which a cheap twin may differ."""

_SLUG = r"[A-Za-z0-9_][A-Za-z0-9_-]*(\.[A-Za-z0-9_-]+)*"


def _slug(text: str) -> str:
    if not re.fullmatch(_SLUG, text) or len(text) > 100:
        raise ValueError("a name may contain a-z, A-Z, digits, '_', '-' and inner '.', at most 100 of them")
    return text


def _bound(value: str | float) -> str:
    text = value if isinstance(value, str) else f"< {value!r}"
    bound = re.fullmatch(r"\s*(<=|<)?\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*", text)
    if not bound or not 0.0 <= float(bound[2]) <= 1.0:
        raise ValueError("should be an upper bound between 0 and 1 such as '< 2e-2' or '<= 0.1'")
    return f"{bound[1] or '<'} {bound[2]}"


Slug = Annotated[
    str, AfterValidator(_slug), WithJsonSchema({"type": "string", "pattern": f"^{_SLUG}$", "maxLength": 100})
]
Probability = Annotated[float, Field(gt=0.0, lt=1.0)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


REQUIREMENTS = "requirements that the scenario tests, by their ids; only `avrare evidence` reads them"
ODD = "tags of the operational design domain, such as motorway or rain; only `avrare evidence` reads them"
OBJECTIVE = "purpose of the test in a few words; only `avrare evidence` reads it"


class ScoreFormula(_Model):
    """Formula that orders particles in splitting and does not affect the verdict."""

    stl: str = Field(description="rollouts are ordered by how close they have come to violating it")


class Formula(_Model):
    """Specification given as a formula."""

    stl: str = Field(
        description="signal temporal logic formula over the simulator's signals, e.g. always (gap > 2.0)"
    )
    until: Literal["closed", "half-open"] = Field(
        "closed", description="whether the window of `until` includes its end; half-open as in rtamt"
    )
    score: ScoreFormula | str | None = Field(
        None,
        description="score that orders particles: a name or {stl: formula}; default: by the formula's shape",
    )


class Threshold(_Model):
    """Upper bound on the failure probability of a specification."""

    specification: str = Field(description="name of one of the scenario's specifications")
    probability: Annotated[str | float, AfterValidator(_bound)] = Field(
        description="upper bound such as '< 2e-2' or '<= 0.1'; a plain number means '<'"
    )
    confidence: Probability = Field(
        0.95, description="confidence level of the interval that must lie below the bound, in (0, 1)"
    )
    blind: Literal["assumed", "counted"] = Field(
        "assumed",
        description="failures that the score does not lead to: assumed away, as the verdict says, or "
        "counted: their upper bound must lie below the bound, too",
    )

    @property
    def limit(self) -> float:
        """Bound as a number."""
        return float(str(self.probability).split()[1])

    @property
    def strict(self) -> bool:
        """True for ``<``, False for ``<=``."""
        return str(self.probability).startswith("< ")


class Regression(_Model):
    """Comparison of `avrare check` with a saved baseline."""

    ratio: float = Field(
        1.0,
        gt=0.0,
        allow_inf_nan=False,
        description="fail if the probability is significantly above this multiple of the baseline",
    )
    exclude: float | None = Field(
        None,
        gt=0.0,
        description="pass if the probability is significantly below this multiple of the baseline; "
        "default: twice `ratio`",
    )
    confidence: Probability = Field(0.95, description="confidence level of the comparison, in (0, 1)")

    @model_validator(mode="after")
    def _check_order(self) -> Regression:
        if self.exclude is not None and self.exclude <= self.ratio:
            raise ValueError(f"exclude ({self.exclude:g}) must be greater than ratio ({self.ratio:g})")
        return self

    @property
    def excluded(self) -> float:
        """``exclude``, or its default."""
        return 2.0 * self.ratio if self.exclude is None else self.exclude


def _suppressible(name: str) -> str:
    try:
        default_registry().check_suppressed((name,))
    except UsageError as error:
        raise error_with_hint(error.message, error.hint) from None
    return name


HealthWarning = Annotated[str, AfterValidator(_suppressible)]


class Cheap(_Model):
    """Cheap twin of the stack: parts, or options of parts, that differ from the scenario's own."""

    cost: float | None = Field(
        None, gt=0.0, lt=1.0, description="time of the twin's rollout over that of the stack's; mfmc needs it"
    )
    simulator: dict[str, Any] | None = Field(None, description="differences of the simulator")
    perception: dict[str, Any] | None = Field(None, description="differences of perception")
    tracker: dict[str, Any] | None = Field(None, description="differences of the tracker")
    controller: dict[str, Any] | None = Field(None, description="differences of the controller")


def _refuse_bare_name(value: object) -> object:
    if isinstance(value, str):
        message = f"should be a mapping, found the string {value!r}"
        raise error_with_hint(message, f"write {{plugin: {value}}}")
    return value


Part = Annotated[dict[str, Any], BeforeValidator(_refuse_bare_name)]
"""Block of a part: its plugin's name, and the options that the plugin checks."""


class Document(_Model):
    """Scenario file after ``extends`` and overrides; component blocks are checked by their plugins."""

    name: Slug = Field(description="name of the scenario and of its results folder")
    description: str | None = Field(None, description="subject of the scenario")
    requirements: tuple[str, ...] = Field((), description=REQUIREMENTS)
    odd: tuple[str, ...] = Field((), description=ODD)
    objective: str | None = Field(None, description=OBJECTIVE)
    steps: int = Field(ge=0, le=10_000_000, description="steps per rollout; 0 for a static problem")
    simulator: Part = Field(description="simulator of the world")
    perception: Part | None = Field(None, description="perception error model")
    tracker: Part | None = Field(None, description="tracker and predictor")
    controller: Part | None = Field(None, description="controller (planner) under test")
    aeb: Aeb | None = Field(None, description="automatic emergency braking beside the controller")
    timing: Timing | None = Field(None, description="latencies, periods and losses of the stack")
    actuators: Actuators | None = Field(None, description="lag and limits between controller and plant")
    specifications: dict[Slug, dict[str, Any]] = Field(
        min_length=1,
        max_length=1000,
        description="name -> {stl: formula} or {plugin: name, ...}; more need a scenario of their own",
    )
    estimator: Part = Field({"plugin": "auto"}, description="estimator of the failure probability")
    cheap: Cheap | None = Field(
        None, description="cheap twin of the stack, which estimator mfmc runs on many tapes"
    )
    ensemble: dict[str, tuple[Any, ...]] = Field(
        {},
        description="draws of uncertain parameters of the model: path -> value in each draw, such "
        "as perception.member: [1, 2, 3]; the interval then includes the model",
    )
    thresholds: tuple[Threshold, ...] = Field((), description="bounds that `avrare check` decides")
    exposure: Exposure | None = Field(None, description="how often this scene is met: gives rates in reports")
    regression: Regression | None = Field(None, description="how `avrare check` compares with a baseline")
    seed: int = Field(0, ge=0, lt=2**63, description="seed of all random numbers")
    chunk: int | None = Field(
        None,
        ge=1,
        le=1_000_000,
        description="rollouts per chunk of work; default: chosen, results are the same",
    )
    rollout_timeout: float | None = Field(
        None,
        gt=0.0,
        allow_inf_nan=False,
        description="seconds that a single rollout may take, else it is an error; all run in worker "
        "processes, so one that ends its process is an error, too",
    )
    max_error_rate: float = Field(
        0.01, ge=0.0, le=1.0, description="fraction of rollouts that may end in an error"
    )
    confidence: Probability = Field(0.95, description="confidence level of the reported intervals, in (0, 1)")
    suppress: tuple[HealthWarning, ...] = Field((), description="names of health warnings to suppress")
    cross_check: Annotated[
        CrossCheck | None, BeforeValidator(as_cross_check, json_schema_input_type=bool | CrossCheck)
    ] = Field(
        None,
        description="check each estimate by a smaller one of another family: true, or options",
    )


@dataclass(frozen=True)
class Block:
    """Component of a scenario with its checked options, an object of its own class of ``Options``.

    Options that are drawn stand in ``config`` with the medians of their laws, and in ``draws``.
    """

    plugin: str
    component: Component
    config: Options
    distribution: str = ""
    version: str = ""
    draws: Draws | None = None

    @property
    def resolved(self) -> dict[str, object]:
        """Block as plain data with all defaults."""
        options = self.config.model_dump(mode="json", by_alias=True, warnings=False)
        if self.draws is not None:
            self.draws.write_into(options)
        return {"plugin": self.plugin, **options}


@dataclass(frozen=True)
class Scenario:
    """Checked scenario; nothing is built and nothing heavy is imported. ``Document`` describes its keys.

    Attributes:
        path: File, as the user wrote it.
        estimated: Names of the specifications to estimate, in the scenario's order (the estimator option
            ``specifications``; all of them by default).
        cheap: The cheap twin, as a scenario of its own; None where there is none.
        cheap_cost: Cost of its rollouts, in rollouts of this one; None: not named.
        ensemble: Values of parameters in each draw of the model.
        members: The scenario with the values of each draw.
        warnings: (message, hint) on specifications that are valid but may not mean what was intended.
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
    aeb: Aeb | None = None
    timing: Timing | None = None
    actuators: Actuators | None = None
    thresholds: tuple[Threshold, ...] = ()
    exposure: Exposure | None = None
    regression: Regression | None = None
    description: str | None = None
    requirements: tuple[str, ...] = ()
    odd: tuple[str, ...] = ()
    objective: str | None = None
    seed: int = 0
    chunk: int | None = None
    rollout_timeout: float | None = None
    max_error_rate: float = 0.01
    confidence: float = 0.95
    suppress: tuple[str, ...] = ()
    cross_check: CrossCheck | None = None
    cheap: Scenario | None = None
    cheap_cost: float | None = None
    ensemble: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    members: tuple[Scenario, ...] = ()
    warnings: tuple[tuple[str, str | None], ...] = field(default=(), compare=False)

    @property
    def blocks(self) -> dict[str, Block]:
        """Component blocks by dotted path, for instance ``tracker`` or ``specifications.safe``."""
        named = {key: getattr(self, key) for key in PARTS}
        named |= {f"specifications.{name}": part for name, part in self.specifications.items()}
        return {key: part for key, part in named.items() if isinstance(part, Block)}

    @property
    def versions(self) -> dict[str, str]:
        """Versions of avrare and of every distribution that the scenario uses."""
        used = {part.distribution: part.version for part in self.blocks.values() if part.distribution}
        for part in self.blocks.values():  # of parts that choose further ones
            used |= part.config.used_versions()
        if self.cross_check is not None:
            used |= self.cross_check.versions
        if self.cheap is not None:
            used |= self.cheap.versions
        return dict(sorted({**used, "avrare": version.__version__}.items()))

    @property
    def resolved(self) -> dict[str, object]:
        """Scenario as plain data with all defaults; loading it gives an equal scenario."""
        plain: dict[str, Any] = {"name": self.name, "description": self.description, "steps": self.steps}
        plain |= {key: list(tags) for key in ("requirements", "odd") if (tags := getattr(self, key))}
        plain |= {"objective": self.objective} if self.objective else {}
        plain |= {key: part.resolved for key in PARTS if (part := getattr(self, key))}
        for key in ("aeb", "timing", "actuators"):
            if (block := getattr(self, key)) is not None:
                plain[key] = block.model_dump()
        plain["estimator"] = {**plain["estimator"], "specifications": list(self.estimated)}
        plain["specifications"] = {
            name: part.resolved if isinstance(part, Block) else part.model_dump()
            for name, part in self.specifications.items()
        }
        plain["thresholds"] = [threshold.model_dump() for threshold in self.thresholds]
        if self.exposure is not None:
            plain["exposure"] = self.exposure.model_dump(mode="json", exclude_none=True)
        if self.regression is not None:
            plain["regression"] = self.regression.model_dump()
        plain |= {key: getattr(self, key) for key in ("seed", "chunk", "max_error_rate", "confidence")}
        if self.rollout_timeout is not None:
            plain["rollout_timeout"] = self.rollout_timeout
        plain["suppress"] = list(self.suppress)
        if self.cross_check is not None:
            plain["cross_check"] = self.cross_check.model_dump()
        if self.cheap is not None:
            other = self.cheap.resolved
            differing = {key: other.get(key) for key in TWIN_PARTS if other.get(key) != plain.get(key)}
            plain["cheap"] = {"cost": self.cheap_cost, **differing}
        if self.ensemble:
            plain["ensemble"] = {path: list(values) for path, values in self.ensemble.items()}
        return plain
