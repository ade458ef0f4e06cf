"""Options of elliptical slice sampling with nested levels."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

KernelName = Literal["pcn", "shrink", "lipschitz", "surrogate", "lipschitz_growing", "bayesian"]


class EssConfig(BaseModel):
    """Nested levels (holmes-diaconis-ross) with Markov chains on the noise tape (stl-ess)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    chains: int = Field(
        default=50,
        ge=2,
        le=1_000_000,
        description="parallel chains of a run; level_probability sets their length",
    )
    skip: int = Field(default=0, ge=0, le=100, description="steps of a chain between two samples that count")
    level_probability: float = Field(
        default=0.1,
        ge=1e-3,
        le=0.5,
        description="share of the samples above the next level; a chain gives 1 / this samples a level",
    )
    runs: int = Field(default=10, ge=1, description="independent repetitions behind one interval")
    kernel: KernelName = Field(
        default="pcn",
        description="how a chain moves. Valid: pcn, shrink, lipschitz, surrogate; biased, to compare with "
        "the paper: lipschitz_growing, bayesian",
    )
    lipschitz: float | None = Field(
        default=None,
        gt=0.0,
        description="lipschitz: bound on the slope of the score, per unit of Euclidean length of the tape; "
        "lipschitz_growing: first guess of it per radian of an ellipse (1)",
    )
    bracket: float | None = Field(
        default=None,
        gt=0.0,
        lt=2.0 * math.pi,
        description="shrink: width of the first bracket, radians; 3 spares a third of the rollouts where the "
        "set is narrow, and seldom changes sides (the whole ellipse)",
    )
    second_pass: bool = Field(
        default=True,
        description="count in a fresh sample at the levels that a pilot has found: unbiased; without it the "
        "pilot itself counts",
    )
    pilot: float = Field(
        default=0.25, gt=0.0, le=1.0, description="chains of the pilot over those that count; second_pass"
    )
    floor: float = Field(
        default=1e-18, gt=0.0, lt=1.0, description="a run ends, as extinct, once its weight falls below this"
    )

    @model_validator(mode="after")
    def _options_of_the_kernel(self) -> EssConfig:
        if self.kernel == "lipschitz" and self.lipschitz is None:
            raise ValueError(
                "kernel lipschitz needs lipschitz, a bound on the score's slope; without one use shrink"
            )
        if self.lipschitz is not None and not self.kernel.startswith("lipschitz"):
            raise ValueError(f"lipschitz is no option of kernel {self.kernel}")
        if self.bracket is not None and self.kernel != "shrink":
            raise ValueError(f"bracket is no option of kernel {self.kernel}")
        return self

    @property
    def length(self) -> int:
        """Samples that a chain gives at each level."""
        return max(2, math.ceil(1.0 / self.level_probability - 1e-9))
