"""Options of ``ams``."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from avrare_estimators.common.config import LEARNED, LEAST_PILOT, GrowingConfig


class AmsConfig(GrowingConfig):
    """Adaptive multilevel splitting (stl-ams, Algorithm 2, in its unbiased form)."""

    size = "particles"
    particles: int = Field(default=250, ge=2, le=10**9, description="N, particles of a run")
    discard: int = Field(default=25, ge=1, description="K, particles discarded at each level (more on ties)")
    variant: Literal["unbiased", "published"] = Field(
        default="unbiased",
        description="published: Algorithm 2 of stl-ams as its code ran it, for comparison: K + 1 discarded, "
        "levels on the robustness of the prefix, robustness <= 0 is failure",
    )
    look_ahead: int | None = Field(
        default=None,
        ge=1,
        description="score by the robustness of the noise-free continuation, every so many steps, in place "
        "of the problem's score; its steps are counted apart, as look_ahead_steps",
    )
    score: Literal["problem", "learned"] = Field(
        default="problem",
        description="learned: score by the committor that a network learns in a run which does not count, "
        "where rollouts held out promise a gain over the problem's own score",
    )
    pilot: int = Field(
        default=1000,
        ge=LEAST_PILOT,
        description="particles of the run to learn the score from; score: learned",
    )
    learned: str | None = Field(
        default=None,
        description="file of a learned score (learned.json of a run folder): score by it, without learning",
        json_schema_extra={"file": True},
    )
    early_stop: bool = Field(
        default=False,
        description="end a rollout once its verdict cannot change; robustness is that of the samples so far",
    )
    floor: float = Field(
        default=1e-18, gt=0.0, lt=1.0, description="a run ends, as extinct, once its weight falls below this"
    )

    @property
    def has_pilot(self) -> bool:
        """A pilot precedes the runs that count; the published variant has none."""
        return self.variant == "unbiased"

    @property
    def scores_by_committor(self) -> bool:
        """A learned score is asked for, or given."""
        return self.score == LEARNED or self.learned is not None

    @model_validator(mode="after")
    def _fit_variant(self) -> Self:
        for name in ("early_stop", "look_ahead"):
            if getattr(self, name) and self.variant == "published":
                raise ValueError(f"the published variant does not have {name}: leave it out")
            if getattr(self, name) and self.scores_by_committor:
                raise ValueError(f"{name} does not go with a learned score: leave one of them out")
        if self.scores_by_committor and self.variant == "published":
            raise ValueError("the published variant does not have a learned score: leave it out")
        if self.pilot != type(self).model_fields["pilot"].default and self.score != LEARNED:
            raise ValueError("pilot belongs to `score: learned`")
        return self

    @model_validator(mode="after")
    def _discard_fewer_than_all(self) -> Self:
        if self.discard >= self.particles:
            given = "" if "discard" in self.model_fields_set else ", its default"
            text = f"discard ({self.discard}{given}) must be less than particles ({self.particles}): set both"
            raise ValueError(text)
        return self
