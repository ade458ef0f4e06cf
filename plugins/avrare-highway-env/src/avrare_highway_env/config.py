"""What a scenario says about a highway-env world. SI units; y is positive to the left."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

SceneName = Literal["merge", "highway", "intersection", "roundabout"]


class LidarConfig(BaseModel):
    """A ring of rays around the ego's centre; ray k points 2 pi k / cells to the left of the x axis."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    cells: int = Field(default=240, ge=1, description="rays")
    range: float = Field(default=60.0, gt=0.0, description="farther objects are not seen [m]")
    speeds: bool = Field(default=True, description="also measure the radial speed of what a ray hits")
    noise_variance: float = Field(
        default=0.0,
        ge=0.0,
        description="variance of the normal number added to every ray's distance, which is normalised to "
        "[0, 1] and clipped back to it; 0: no noise",
    )


class TrafficConfig(BaseModel):
    """Moods of the other drivers: an Ornstein-Uhlenbeck process added to their accelerations."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    acceleration_sd: float = Field(
        default=0.0, ge=0.0, description="standard deviation of the mood [m/s^2]; 0: no moods"
    )
    correlation_time: float = Field(default=1.0, gt=0.0, description="how long a mood lasts [s]")


class HighwayEnvConfig(BaseModel):
    """Options of the simulator ``highway_env``."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    scene: SceneName = Field(default="merge", description="which of highway-env's roads")
    dt: float = Field(default=0.1, gt=0.0, le=1.0, description="step between two actions [s]")
    substeps: int = Field(default=1, ge=1, description="integration steps in it")
    start_seed: int | None = Field(
        default=None,
        ge=0,
        description="all runs start as highway-env's reset(seed) would have them; "
        "without: every run's start is drawn from its noise",
    )
    vehicles: int | None = Field(
        default=None,
        ge=1,
        le=60,
        description="vehicles at the start, for highway (others) and intersection (about; they come and go); "
        "default 10",
    )
    lanes: int = Field(default=3, ge=1, le=8, description="lanes of the scene highway")
    goal: float | None = Field(
        default=None, gt=0.0, description="x at which the run is over [m], merge and highway; merge: 370"
    )
    lidar: LidarConfig | None = Field(default=None, description="what the ego observes beside itself")
    traffic: TrafficConfig = Field(default_factory=TrafficConfig, description="the other drivers")

    @model_validator(mode="after")
    def _known_to_the_scene(self) -> Self:
        if self.scene in ("merge", "roundabout") and self.vehicles is not None:
            raise ValueError(f"the scene {self.scene} has four other vehicles, no other number")
        if self.scene not in ("merge", "highway") and self.goal is not None:
            raise ValueError(f"the scene {self.scene} has no straight road: leave out goal")
        if self.scene == "intersection" and self.dt / self.substeps > 0.5:
            raise ValueError("the intersection settles its right of way twice a second: dt / substeps <= 0.5")
        return self
