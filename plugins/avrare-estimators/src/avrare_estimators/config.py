"""Options of the estimators, named as in the literature and counted per run."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator


class AmsConfig(BaseModel):
    """Adaptive multilevel splitting (stl-ams, Algorithm 2, in its unbiased form)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    particles: int = Field(default=250, ge=2, description="N, rollouts alive in a run")
    discard: int = Field(default=25, ge=1, description="K, rollouts discarded at each level (more on ties)")
    runs: int = Field(default=10, ge=1, description="independent repetitions behind one interval")
    variant: Literal["unbiased", "published"] = Field(
        default="unbiased",
        description="published: Algorithm 2 of stl-ams as its code ran it, for comparison: K + 1 discarded, "
        "levels on the robustness of the prefix, robustness <= 0 is failure",
    )
    floor: float = Field(
        default=1e-18, gt=0.0, lt=1.0, description="a run ends, as extinct, once its weight falls below this"
    )
    memory: float = Field(
        default=1024.0, gt=0.0,
        description="MiB for the states that branches start from; where they do not suffice, those of every "
        "second, fourth, ... step are kept and the rest is driven again, at the cost of these steps",
    )  # fmt: skip

    @model_validator(mode="after")
    def _fewer_discards_than_particles(self) -> AmsConfig:
        if self.discard >= self.particles:
            raise ValueError(f"discard ({self.discard}) must be less than particles ({self.particles})")
        return self


class _WeightedConfig(BaseModel):
    """What importance sampling and cross-entropy share."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    runs: int = Field(default=1, ge=1, description="independent repetitions behind one interval")
    defensive: float = Field(
        default=0.1, ge=0.0, lt=1.0, description="share of a sample's rollouts drawn from the target itself"
    )
    check: float = Field(
        default=0.25,
        ge=0.0,
        le=0.5,
        description="share of the rollouts that take a second look at the failures; 0: none",
    )


class IsConfig(_WeightedConfig):
    """Importance sampling from a given proposal."""

    rollouts: int = Field(default=1000, ge=2, description="rollouts of each run")
    proposal: Any = Field(
        description="{gaussian: {mean: ..., std: ...}} of the noise, or {plugin: NAME, ...}: a perception "
        "model with log_prob"
    )

    @field_validator("proposal")
    @classmethod
    def _usable(cls, proposal: Any) -> Any:
        from avrare.errors import AvrareError
        from avrare_estimators.proposals import check

        try:
            check(proposal)
        except AvrareError as error:
            raise ValueError(f"{error.message} ({error.hint})" if error.hint else error.message) from None
        return proposal


class CeConfig(_WeightedConfig):
    """The cross-entropy method: learn a proposal from the rollouts nearest to failure, then sample afresh."""

    rollouts: int = Field(default=1000, ge=20, description="rollouts of each stage")
    stages: int = Field(default=10, ge=1, le=1000, description="most stages of learning")
    elite: float = Field(default=0.1, gt=0.0, le=0.5, description="share of a stage's rollouts to learn from")
    family: Literal["gaussian", "network"] = Field(
        default="gaussian",
        description="what is learnt: a Gaussian law of the noise, or a network from what there is to see to "
        "how it is perceived (needs torch)",
    )
    smoothing: float = Field(
        default=0.8, gt=0.0, le=1.0, description="weight of what a stage learns over what was known; gaussian"
    )
    floor: float = Field(
        default=0.7, gt=0.0, le=1.0, description="least standard deviation of a learnt number; target: 1"
    )
    components: int = Field(default=1, ge=1, le=50, description="Gaussians in the mixture; gaussian")
    hidden: int = Field(default=100, ge=1, le=2000, description="width of both hidden layers; network")
    epochs: int = Field(default=300, ge=1, description="training steps of a stage, all data each; network")
    rate: float = Field(default=1e-3, gt=0.0, description="Adam's learning rate; network")
