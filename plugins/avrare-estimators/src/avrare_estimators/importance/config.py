"""Options of ``is``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    WithJsonSchema,
    field_serializer,
    model_validator,
)

from avrare.base.errors import AvrareError
from avrare.plugin import Options
from avrare_estimators.common.config import LEARNED, LEAST_DEFENSIVE, LEAST_PILOT, WeightedConfig
from avrare_estimators.common.tapes.gaussian_mixture import NoiseProposal

_CHECK_SHARE = 0.3
"""Share of the cross-check where no error to be reached says how much it takes: the samples are
small, and with less it often falls short."""
_MOST_STAGES = 20
"""Stages of ``auto``: a small pilot climbs slowly; learning takes at most half of the rollouts anyway."""
MOST_ROLLOUTS = 300_000
"""Upper bound of a sample with a stopping rule: a failure that is never met must end, too."""


def _list_numbers(numbers: object) -> object:
    return numbers.tolist() if hasattr(numbers, "tolist") else numbers


Numbers = Annotated[float | list[float] | list[list[float]], BeforeValidator(_list_numbers)]
"""A number, one for each channel, or (steps + 1, noise_size) of them."""


class GaussianProposal(Options):
    """Independent Gaussians of the noise."""

    name: Literal["gaussian"] = "gaussian"
    mean: Numbers = Field(
        default=0.0, description="a number, one for each channel, or (steps + 1, noise_size) of them"
    )
    std: Numbers = Field(default=1.0, description="standard deviation, in the same form")


def is_perception(proposal: object) -> bool:
    """Return whether a proposal is a perception model, or names one."""
    names = ("observe", "log_prob", "noise_size")
    return isinstance(proposal, Mapping) or all(hasattr(proposal, name) for name in names)


def _check_plugin(proposal: Mapping[str, object]) -> Mapping[str, object]:
    from avrare.rollout.weighted_problem import check_proposal

    try:
        check_proposal(proposal)
    except AvrareError as error:
        raise ValueError(f"{error.message} ({error.hint})" if error.hint else error.message) from None
    return proposal


def _check_object(proposal: object) -> object:
    if isinstance(proposal, NoiseProposal) or (is_perception(proposal) and not isinstance(proposal, Mapping)):
        return proposal
    raise ValueError(
        "should be learned, {name: gaussian, mean: ..., std: ...}, {plugin: NAME, ...}, or in Python an "
        "object with sample(rng, n) and log_ratio(noise), or with observe and log_prob"
    )


def _find_kind(proposal: object) -> str:
    if isinstance(proposal, str):
        return LEARNED
    if isinstance(proposal, Mapping) and "plugin" in proposal:
        return "plugin"
    if isinstance(proposal, GaussianProposal) or (isinstance(proposal, Mapping) and "name" in proposal):
        return "gaussian"
    return "object"


_NAMES_A_PLUGIN = {"type": "object", "properties": {"plugin": {"type": "string"}}, "required": ["plugin"]}
ProposalConfig = Annotated[
    Annotated[Literal["learned"], Tag(LEARNED)]
    | Annotated[GaussianProposal, Tag("gaussian")]
    | Annotated[dict[str, Any], AfterValidator(_check_plugin), WithJsonSchema(_NAMES_A_PLUGIN), Tag("plugin")]
    | Annotated[Any, AfterValidator(_check_object), WithJsonSchema({"not": {}}), Tag("object")],
    Discriminator(_find_kind),
]


class IsConfig(WeightedConfig):
    """Importance sampling from a proposal that is learnt on the noise tape, or given."""

    rollouts: int | None = Field(
        default=None,
        ge=2,
        le=10**12,
        description="rollouts of each run, its learning and cross-check included (default 30,000); with "
        "relative_error, the most (default 300,000)",
    )
    defensive: float | None = Field(
        default=None,
        ge=0.0,
        lt=1.0,
        description="share of a sample's rollouts drawn from the target itself (default 0.5; learned: at "
        "least 0.25, the default then)",
    )
    proposal: ProposalConfig = Field(
        default=LEARNED,
        description="learned, {name: gaussian, mean: ..., std: ...} of the noise, or {plugin: NAME, ...}: a "
        "perception model with log_prob",
    )
    learned: str | None = Field(
        default=None,
        description="file of a learned proposal (learned.json of a run folder), to draw from without a pilot",
        json_schema_extra={"file": True},
    )
    pilot: int = Field(
        default=3000,
        ge=LEAST_PILOT,
        description="rollouts of the target to begin to learn from, at most a sixth of all; each later stage "
        "has half as many; learned",
    )
    stages: int = Field(default=8, ge=1, le=50, description="most stages after the pilot; learned")
    relative_error: float | None = Field(
        default=None,
        ge=1e-3,
        lt=1.0,
        description="draw as many rows as a standard error of this share of the estimate is likely to take; "
        "learned",
    )
    fall_back: bool = Field(
        default=True,
        description="where learning finds nothing, draw from the target; false: end with an error, also "
        "where it did not reach a failure; learned",
    )

    @property
    def learns(self) -> bool:
        """The proposal is on the noise tape, and is learnt or was."""
        return isinstance(self.proposal, str)

    @property
    def most_rollouts(self) -> int:
        """Rollouts of each run, at most."""
        if self.rollouts is None:
            return 30_000 if self.relative_error is None else MOST_ROLLOUTS
        return self.rollouts

    @property
    def target_share(self) -> float:
        """Share of a sample's rollouts drawn from the target itself."""
        if self.defensive is None:
            return LEAST_DEFENSIVE if self.learns else 0.5
        return self.defensive

    @field_serializer("rollouts")
    def _decide_rollouts(self, rollouts: int | None) -> int:
        return self.most_rollouts

    @field_serializer("defensive")
    def _decide_share(self, defensive: float | None) -> float:
        return self.target_share

    @model_validator(mode="after")
    def _fit_learning(self) -> Self:
        if not self.learns:
            # A resolved scenario, such as that of a run folder, gives all options.
            for name in ("learned", "pilot", "stages", "relative_error"):
                if getattr(self, name) != type(self).model_fields[name].default:
                    raise ValueError(f"{name} belongs to `proposal: learned`, not to a given proposal")
            return self
        if self.target_share < LEAST_DEFENSIVE:
            raise ValueError(f"defensive must be at least {LEAST_DEFENSIVE} for a learned proposal")
        if self.relative_error is not None and self.runs > 1:
            raise ValueError("relative_error is a stopping rule for a single run; leave runs at 1")
        return self


def choose_auto_options(relative_error: float | None, pilot: int) -> dict[str, object]:
    """Return the options with which ``auto`` tries ``is``: it gives up where it gains nothing."""
    options = {"pilot": max(LEAST_PILOT, pilot), "stages": _MOST_STAGES, "fall_back": False}
    return options | ({"check": _CHECK_SHARE} if relative_error is None else {})
