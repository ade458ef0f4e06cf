"""What a scenario says about a MetaDrive world and its driver. SI units."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class NoiseConfig(BaseModel):
    """Noise on every ray of the lidar, drawn afresh at every step."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    variance: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="of the normal law around a ray's true distance / 50 m, truncated to [0, 1]; 0: no noise",
    )


class MetaDriveConfig(BaseModel):
    """Options of the simulator ``metadrive``."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    map: str = Field(
        default="r",
        pattern="^[SCrRXOTyY]+$",
        description="MetaDrive's blocks in order: S straight, C curve, r a ramp joins, R a ramp leaves, "
        "X crossing, T junction, O roundabout, y and Y fewer and more lanes",
    )
    traffic_density: float = Field(
        default=0.1,
        ge=0.0,
        le=1.0,
        description="share of the places for vehicles, 10 m of lane each, that are taken",
    )
    traffic_mode: Literal["trigger", "respawn", "hybrid"] = Field(
        default="trigger",
        description="trigger: others drive off when the ego comes; respawn: they drive from the start on, "
        "and come back; hybrid: both",
    )
    start_seed: int = Field(
        default=0, ge=0, le=2**31 - 1, description="of map, traffic and start, the same in all runs"
    )
    lasers: int = Field(default=240, ge=1, le=4096, description="rays of the lidar; the expert needs 240")
    noise: NoiseConfig = Field(default_factory=NoiseConfig, description="on the rays")
    copy_by: Literal["fork", "replay"] = Field(
        default="fork",
        alias="copy",
        description="how a rollout branches from another: fork keeps a sleeping process where others did; "
        "replay drives again from the start",
    )
    step_timeout: float | None = Field(
        default=None, gt=0.0, le=86400.0, description="a reset or step that takes longer [s] is an error"
    )


class ExpertConfig(BaseModel):
    """Options of the controller ``metadrive_expert``: none."""

    model_config = ConfigDict(extra="forbid", frozen=True)
