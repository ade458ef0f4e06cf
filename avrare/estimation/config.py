"""Options of the core's estimators."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class McConfig(BaseModel):
    """Monte Carlo: every rollout is drawn afresh, all specifications are scored in one pass."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rollouts: int = Field(default=1000, ge=1, description="rollouts of each run")
    runs: int = Field(default=1, ge=1, description="independent repetitions behind one interval")
