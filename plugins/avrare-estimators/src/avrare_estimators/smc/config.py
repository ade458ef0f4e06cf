"""Options of ``smc``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from avrare_estimators.common.config import LEAST_DEFENSIVE, LEAST_PILOT, RunsConfig


class SmcConfig(RunsConfig):
    """Sequential Monte Carlo with potentials that are learnt (twisted SMC)."""

    particles: int = Field(default=1000, ge=20, le=10**8, description="N, particles of a run")
    proposal: Literal["learned", "none"] = Field(
        default="learned",
        description="learned: particles draw their noise from a proposal that is learnt on the tape, as `is` "
        "does, where it gains; none: from the target",
    )
    pilot: int = Field(
        default=3000,
        ge=LEAST_PILOT,
        description="rollouts of the target to begin to learn from; each later stage has half as many",
    )
    stages: int = Field(default=8, ge=0, le=50, description="most stages of learning after the pilot")
    defensive: float = Field(
        default=LEAST_DEFENSIVE,
        ge=LEAST_DEFENSIVE,
        lt=1.0,
        description="share of the target in the law that particles are drawn from; learned",
    )
    times: int = Field(
        default=16, ge=1, le=200, description="most steps of a rollout at which particles may be resampled"
    )
