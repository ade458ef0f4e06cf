"""What a scenario says about the driver along waypoints. SI units; y is positive to the left."""

from __future__ import annotations

from itertools import pairwise

from pydantic import BaseModel, ConfigDict, Field, field_validator

Waypoints = tuple[tuple[float, float], ...]


class PathFollowerConfig(BaseModel):
    """Options of the controller ``path_follower``."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        json_schema_extra={"examples": [{"waypoints": [[2.0, -60.0], [2.0, 60.0]]}]},
    )

    waypoints: Waypoints = Field(
        description="x and y of two or more points of the path [m], in the scene's frame; it is straight in "
        "between, goes straight on after the last, and keeps away from itself"
    )
    cruise_speed: float = Field(default=8.0, gt=0.0, description="where the path ahead is free [m/s]")
    lookahead_time: float = Field(
        default=0.6, ge=0.0, description="the ego steers for the point it reaches so much later [s]"
    )
    least_lookahead: float = Field(default=6.0, gt=0.0, description="and at least so far ahead [m]")
    corridor_width: float = Field(
        default=3.0, gt=0.0, description="vehicles that reach into it are on the path [m]"
    )
    foresight: float = Field(
        default=0.0,
        ge=0.0,
        description="so are those that reach into it within this time at their speed and heading of now [s]",
    )
    time_gap: float = Field(default=1.0, ge=0.0, description="to the nearest vehicle on the path ahead [s]")
    standstill_gap: float = Field(default=3.0, gt=0.0, description="to it at rest, bumper to bumper [m]")
    acceleration: float = Field(default=3.0, gt=0.0, description="largest [m/s^2]")
    deceleration: float = Field(default=4.0, gt=0.0, description="comfortable [m/s^2]; the hardest is 5")
    stopping_time: float = Field(
        default=0.2,
        gt=0.0,
        description="braking is at most speed / this [s]: the simulator's dt or more, else the ego reverses",
    )

    @field_validator("waypoints")
    @classmethod
    def _is_a_path(cls, waypoints: Waypoints) -> Waypoints:
        if len(waypoints) < 2:
            raise ValueError(f"a path needs two waypoints or more, there are {len(waypoints)}")
        for place, (one, other) in enumerate(pairwise(waypoints)):
            if one == other:
                raise ValueError(f"waypoint {place + 1} is the same as the one before: leave it out")
        return waypoints
