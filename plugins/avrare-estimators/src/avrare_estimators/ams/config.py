"""Options of ``ams``."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from avrare_estimators.common.config import GrowingConfig


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

    @model_validator(mode="after")
    def _fit_options(self) -> Self:
        if self.early_stop and self.variant == "published":
            raise ValueError("the published variant does not have early_stop: leave it out")
        if self.discard >= self.particles:
            origin = "" if "discard" in self.model_fields_set else ", its default"
            text = (
                f"discard ({self.discard}{origin}) must be less than particles ({self.particles}): set both"
            )
            raise ValueError(text)
        return self
