"""Options of the controller and of scripted trajectories; weights and bounds are the reference experiment's.

Weights multiply squared quantities in SI units and are summed over the nodes of the plan.
"""

from __future__ import annotations

import importlib.util
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from avrare.plugin import Drawable, Options

Weight = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Lane = Annotated[int, Field(ge=0)]


Backend = Literal["casadi", "riccati"]


def installed_backend() -> Backend:
    """Return the backend of scenarios that name none; it becomes part of the resolved scenario."""
    return "casadi" if importlib.util.find_spec("numba") is None else "riccati"


class PlannerConfig(Options):
    """Goals, weights and bounds shared by the controller and the trajectory planner."""

    lanes: tuple[Lane, ...] = Field(
        default=(1, 2),
        min_length=1,
        description="Indices of the lanes of the road that may be used, from the right.",
    )
    y_goal: Finite = Field(default=1.75, description="Preferred lateral position [m].")
    y_goal_weight: Weight = Field(default=25.0, description="Weight of the distance from y_goal [1/m^2].")
    v_goal: Finite = Field(default=31.29, description="Preferred speed [m/s].")
    v_goal_weight: Weight = Field(default=1.0, description="Weight of the distance from v_goal [s^2/m^2].")
    acceleration_weight: Weight = Field(default=50.0, description="Weight of acceleration [s^4/m^2].")
    braking_weight: Weight = Field(
        default=200.0, description="Additional weight of braking, a < 0 [s^4/m^2]."
    )
    turn_rate_weight: Weight = Field(default=0.1, description="Weight of the turn rate [s^2/rad^2].")
    turn_rate_change_weight: Weight = Field(
        default=10.0, description="Weight of the difference of consecutive turn rates [s^2/rad^2]."
    )
    heading_weight: Weight = Field(default=0.0, description="Weight of the heading [1/rad^2].")
    lane_weight: Weight = Field(
        default=5.0,
        description="Weight of the distance from the lane centres, harmonic over the lanes [1/m^2].",
    )
    acceleration_max: Positive = Field(default=11.5, description="Bound of |acceleration| [m/s^2].")
    turn_rate_max: Positive = Field(default=0.5, description="Bound of |turn rate| [rad/s].")
    lateral_acceleration_max: Positive | None = Field(
        default=None,
        description="Bound of |speed x turn rate|, the lateral acceleration [m/s^2]; none: not bounded.",
    )
    speed_min: Finite = Field(default=-36.6, description="Lower bound of the speed [m/s].")
    speed_max: Finite = Field(default=36.6, description="Upper bound of the speed [m/s].")
    heading_max: Positive = Field(default=1.5707963267948966, description="Bound of |heading| [rad].")
    y_penalty: Positive = Field(
        default=1e5,
        description="Weight of each metre outside the lateral bounds [1/m]; a penalty that acts as a bound "
        "wherever the bound can be kept.",
    )

    @field_validator("lanes")
    @classmethod
    def _check_distinct_lanes(cls, lanes: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(lanes)) < len(lanes):  # the lane cost would be 0 / 0 on its centre
            raise ValueError("a lane is named twice")
        return lanes

    @model_validator(mode="after")
    def _check_speed_order(self) -> Self:
        if self.speed_min >= self.speed_max:
            raise ValueError("speed_min must be below speed_max")
        return self


class MpcConfig(PlannerConfig):
    """Options of the lane-change controller ``mpc``."""

    horizon: int = Field(
        default=20, ge=2, le=1000, description="Number of planned steps H; the plan has H + 1 nodes."
    )
    y_margin: Weight = Field(
        default=0.4, description="Room between the ego's side and the edge of its outermost lanes [m]."
    )
    obstacle_weight: Weight = Field(default=500.0, description="Weight of a missing clearance [1/m^2].")
    sharpness: Positive = Field(
        default=10.0, description="Sharpness of the smoothed clearance penalty [1/m]."
    )
    clearance_x: Finite = Field(default=3.0, description="Wanted room along the road [m].")
    clearance_y: Finite = Field(default=1.5, description="Wanted room across the road [m].")
    clearance_ego_lengths: Weight = Field(
        default=1.5, description="Ego lengths between the centres, added to half the other's length [1]."
    )
    clearance_ego_widths: Weight = Field(
        default=1.0, description="Ego widths between the centres, added to half the other's width [1]."
    )
    lateral_lead: Literal["acceleration", "speed"] = Field(
        default="acceleration",
        description="Factor of sin(heading) in the dt^2 term of the lateral clearance: the "
        "acceleration, or the speed as in the reference experiment, where it looks like a slip.",
    )
    wheelbase: Positive | None = Field(
        default=None,
        description="Distance of the ego's axles, from which its slip angle on a road that bends is known "
        "[m]; without it the ego drives some centimetres aside there.",
    )
    lane_ends: bool = Field(
        default=False,
        description="Whether the ego keeps out of lanes where they have not begun or have ended, as if "
        "something stood there, and stops before the end of the one that it is in while no plan leaves it.",
    )
    end_braking: Positive = Field(
        default=5.0, description="Deceleration before the end of the ego's lane, with lane_ends [m/s^2]."
    )
    stops: bool = Field(
        default=True,
        description="Whether the ego brakes in time to stop behind a vehicle that its plan does not pass, "
        "however far ahead the tracker knows of it; without it a plan may find a collision cheaper.",
    )
    stop_braking: Positive = Field(
        default=5.0,
        description="Deceleration for which the ego keeps its distance, with stops; up to acceleration_max "
        "where that is too late [m/s^2].",
    )
    bend_acceleration: Positive | None = Field(
        default=None,
        description="Lateral acceleration that no bend is to demand, for which the ego slows down ahead of "
        "it [m/s^2]; without it the ego does not slow down.",
    )
    bend_braking: Positive = Field(
        default=2.0, description="Deceleration ahead of bends, with bend_acceleration [m/s^2]."
    )
    backend: Backend = Field(
        default_factory=installed_backend,
        description="Solver of the programme: a structured interior-point method for all particles at "
        "once, compiled by numba (riccati; the default where that is installed), or CasADi's solvers, one "
        "particle after another (casadi; else the default).",
    )
    search: Literal["follow", "everywhere"] = Field(
        default="everywhere",
        description="Where each step after the first looks for its plan: near the old plan, or also near "
        "the first step's initial guesses (each lane, constant speed and braking); the cheapest plan counts.",
    )
    smooth_start: bool = Field(
        default=False,
        description="Whether turn_rate_change_weight also ties the first planned turn rate to the last one, "
        "as a steering that cannot jump; without it, a new plan may begin with any turn rate.",
    )
    solver: Literal["fatrop", "ipopt"] = Field(
        default="fatrop",
        description="Solver of the casadi backend that is tried first; ipopt also stands behind fatrop when "
        "that fails.",
    )


class LaneSchedule(Options):
    """Steps, first and last included, at which only one lane counts."""

    from_step: int = Field(ge=0, description="First step of the stretch.")
    to_step: int = Field(ge=0, description="Last step of the stretch.")
    lane: Lane = Field(description="Index of the lane of the road.")

    @model_validator(mode="after")
    def _check_step_order(self) -> Self:
        if self.to_step < self.from_step:
            raise ValueError("to_step must not be before from_step")
        return self


class TrajectoryPlan(PlannerConfig):
    """Plan of a scripted vehicle over all its steps; it ignores other vehicles."""

    y_goal: Annotated[Drawable, Field(allow_inf_nan=False)] = Field(
        default=1.75, description="Preferred lateral position [m]."
    )
    v_goal: Annotated[Drawable, Field(allow_inf_nan=False)] = Field(
        default=31.29, description="Preferred speed [m/s]."
    )
    steps: int = Field(
        default=80,
        ge=3,
        le=2000,
        description="Number of samples of the trajectory, the start included; then the vehicle keeps its "
        "velocity.",
    )
    schedule: tuple[LaneSchedule, ...] = Field(
        default=(), description="Stretches with a fixed lane; at other steps every lane of `lanes` attracts."
    )
    y_min: Finite = Field(default=1.237, description="Lower bound of the lateral position [m].")
    y_max: Finite = Field(default=5.763, description="Upper bound of the lateral position [m].")

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        if self.y_min >= self.y_max:
            raise ValueError("y_min must be below y_max")
        parts = sorted(self.schedule, key=lambda part: part.from_step)
        last = max((part.to_step for part in parts), default=0)
        if last >= self.steps:
            raise ValueError(f"the schedule reaches step {last}, the last one is {self.steps - 1}")
        if any(later.from_step <= earlier.to_step for earlier, later in pairwise(parts)):
            raise ValueError("the stretches of the schedule overlap")
        return self

    def fixed_lanes(self) -> dict[int, int]:
        """Return the lane of each step with a fixed lane."""
        return {step: part.lane for part in self.schedule for step in range(part.from_step, part.to_step + 1)}
