"""Options of the estimators, named as in the literature and counted per run."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, model_validator


class AmsConfig(BaseModel):
    """Adaptive multilevel splitting (stl-ams, Algorithm 2, in its unbiased form)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    particles: int = Field(default=250, ge=2, description="N, rollouts alive in a run")
    discard: int = Field(default=25, ge=1, description="K, rollouts discarded at each level (more on ties)")
    runs: int = Field(default=10, ge=1, description="independent repetitions behind one interval")
    floor: float = Field(
        default=1e-18, gt=0.0, lt=1.0, description="a run ends, as extinct, once its weight falls below this"
    )

    @model_validator(mode="after")
    def _fewer_discards_than_particles(self) -> AmsConfig:
        if self.discard >= self.particles:
            raise ValueError(f"discard ({self.discard}) must be less than particles ({self.particles})")
        return self
