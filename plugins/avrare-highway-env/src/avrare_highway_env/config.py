"""Options of ``highway_env`` and ``path_follower``. SI units; y is positive to the left."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal, Self

from pydantic import ConfigDict, Field, field_validator, model_validator

from avrare.plugin import Drawable, Options

Waypoints = tuple[tuple[float, float], ...]
SceneName = Literal["merge", "highway", "intersection", "roundabout"]


class LidarConfig(Options):
    """Ring of rays around the ego's centre; ray k points 2 pi k / cells to the left of the x axis."""

    cells: int = Field(default=240, ge=1, description="number of rays")
    range: float = Field(default=60.0, gt=0.0, description="range of the rays [m]")
    speeds: bool = Field(default=True, description="also measure the radial speeds of hit objects")
    noise_variance: float = Field(
        default=0.0,
        ge=0.0,
        description="variance of the normal noise on every ray's distance, normalised and clipped to "
        "[0, 1]; 0: no noise",
    )


class TrafficConfig(Options):
    """Other drivers, and their moods: an Ornstein-Uhlenbeck process added to their accelerations."""

    acceleration_sd: Drawable = Field(
        default=0.0, ge=0.0, description="standard deviation of the mood [m/s^2]; 0: no moods"
    )
    correlation_time: float = Field(default=1.0, gt=0.0, description="correlation time of a mood [s]")
    desired_speed: Drawable | None = Field(
        default=None, gt=0.0, description="speed on a free road of all drivers [m/s]; default: the scene's"
    )
    time_gap: Drawable | None = Field(
        default=None, gt=0.0, description="time gap to the vehicle ahead [s]; default: 1.5, as in highway-env"
    )
    acceleration: Drawable | None = Field(
        default=None, gt=0.0, description="acceleration on a free road [m/s^2]; default: the scene's"
    )
    deceleration: Drawable | None = Field(
        default=None, gt=0.0, description="comfortable deceleration [m/s^2]; default: the scene's"
    )
    bend_acceleration: float | None = Field(
        default=None,
        gt=0.0,
        description="lateral acceleration that limits speeds in bends of roundabout and intersection "
        "[m/s^2]; default: no limit, as in highway-env: up to 16 and 10 m/s, which no car drives there",
    )


class HighwayEnvConfig(Options):
    """Options of the simulator ``highway_env``."""

    scene: SceneName = Field(default="merge", description="road of highway-env")
    dt: float = Field(default=0.1, gt=0.0, le=1.0, description="time step [s]")
    substeps: int = Field(default=1, ge=1, description="integration steps per time step")
    start_seed: int | None = Field(
        default=None,
        ge=0,
        description="seed of highway-env's reset, the same in all rollouts; default: every rollout draws its "
        "start from its noise",
    )
    vehicles: int | None = Field(
        default=None,
        ge=1,
        le=60,
        description="other vehicles at the start, for highway and intersection (about; they come and "
        "go); default 10",
    )
    lanes: int = Field(default=3, ge=1, le=8, description="number of lanes of the scene highway")
    goal: float | None = Field(
        default=None,
        gt=0.0,
        description="x at which a rollout is over [m], for merge (default 370) and highway",
    )
    way: Literal["left", "straight", "right"] = Field(
        default="straight", description="the ego's way over the intersection, which the rules there judge"
    )
    ego_speed: Drawable | None = Field(
        default=None, ge=0.0, le=40.0, description="speed of the ego at the start [m/s]; default: the scene's"
    )
    lidar: LidarConfig | None = Field(default=None, description="lidar of the ego")
    traffic: TrafficConfig = Field(default_factory=TrafficConfig, description="moods of the other drivers")

    @model_validator(mode="after")
    def _check_scene(self) -> Self:
        if self.scene in ("merge", "roundabout") and self.vehicles is not None:
            raise ValueError(f"the scene {self.scene} always has four other vehicles: omit vehicles")
        if self.scene in ("merge", "highway") and self.traffic.bend_acceleration is not None:
            raise ValueError(f"the scene {self.scene} has no bend: omit traffic.bend_acceleration")
        if self.scene not in ("merge", "highway") and self.goal is not None:
            raise ValueError(f"the scene {self.scene} has no straight road: omit goal")
        if self.scene != "intersection" and self.way != "straight":
            raise ValueError(f"the scene {self.scene} has no intersection: omit way")
        if self.scene == "intersection" and self.dt / self.substeps > 0.5:
            raise ValueError(
                "the intersection updates its right of way twice a second: dt / substeps must be at most 0.5"
            )
        return self


class PathFollowerConfig(Options):
    """Options of the controller ``path_follower``."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"waypoints": [[2.0, -60.0], [2.0, 60.0]]}]})

    waypoints: Waypoints = Field(
        description="x and y of two or more points of the path [m], in the scene's frame; straight "
        "between them and after the last, and must not cross itself"
    )
    cruise_speed: float = Field(default=8.0, gt=0.0, description="speed on a free path [m/s]")
    lookahead_time: float = Field(
        default=0.6, ge=0.0, description="the ego steers to the point that it reaches after this time [s]"
    )
    least_lookahead: float = Field(default=6.0, gt=0.0, description="smallest distance of that point [m]")
    corridor_width: float = Field(
        default=3.0, gt=0.0, description="width of the corridor in which vehicles count as on the path [m]"
    )
    foresight: float = Field(
        default=0.0,
        ge=0.0,
        description="vehicles that enter the corridor within this time at constant velocity also count [s]",
    )
    time_gap: float = Field(default=1.0, ge=0.0, description="time gap to the nearest vehicle ahead [s]")
    standstill_gap: float = Field(default=3.0, gt=0.0, description="gap to it at rest, bumper to bumper [m]")
    acceleration: float = Field(default=3.0, gt=0.0, description="maximal acceleration [m/s^2]")
    deceleration: float = Field(
        default=4.0, gt=0.0, description="comfortable deceleration [m/s^2]; the maximum is 5"
    )
    stopping_time: float = Field(
        default=0.2,
        gt=0.0,
        description="deceleration is at most speed / this [s]; below the simulator's dt the ego reverses",
    )

    @field_validator("waypoints")
    @classmethod
    def _check_path(cls, waypoints: Waypoints) -> Waypoints:
        if len(waypoints) < 2:
            raise ValueError(f"a path needs at least two waypoints, found {len(waypoints)}")
        for place, (first, second) in enumerate(pairwise(waypoints)):
            if first == second:
                raise ValueError(f"waypoint {place + 1} is the same as the one before: remove it")
        return waypoints
