"""Times of a stack (latencies, periods, losses), its actuators, and automatic emergency braking beside it."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from avrare.base.errors import UsageError

_Seconds = Annotated[float, Field(ge=0.0, le=10.0)]
_Period = Annotated[float, Field(gt=0.0, le=10.0)]
_Share = Annotated[float, Field(ge=0.0, le=0.5)]
_Positive = Annotated[float, Field(gt=0.0)]


class Timing(BaseModel):
    """Times at which the parts of a stack work, and how late their answers are."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    sensor_period: _Period | None = Field(
        default=None, description="time between frames, which perception is built with; default: the step [s]"
    )
    tracker_period: _Period | None = Field(
        default=None, description="time between updates of the tracker, likewise; default: sensor_period [s]"
    )
    planner_period: _Period | None = Field(
        default=None,
        description="time between plans and of a step of a plan; default: the simulator's step [s]",
    )
    perception_latency: _Seconds = Field(
        default=0.0,
        description="time from a frame to its detections, which the next update of the tracker reads [s]",
    )
    perception_jitter: _Seconds = Field(
        default=0.0,
        description="half of the frames are later, by a half-normal time of this standard deviation [s]",
    )
    lost_frames: _Share = Field(default=0.0, description="share of frames that never arrive [-]")
    planning_latency: _Seconds = Field(
        default=0.0, description="time from the start of a plan to its command [s]"
    )
    missed_cycles: _Share = Field(
        default=0.0, description="share of planning cycles that give no command: the last one stays [-]"
    )
    actuation_delay: _Seconds = Field(
        default=0.0, description="time from a command to the actuators' answer [s]"
    )
    compensated: bool = Field(
        default=False,
        description="the planner knows all latencies, and plans from where the vehicles will be; detections "
        "that are late by jitter are moved on at their speed",
    )

    def find_faults(self, dt: float) -> dict[str, UsageError]:
        """Find mistakes in the times of options for a simulator whose step is ``dt`` [s]."""
        names = ("sensor_period", "tracker_period", "planner_period", "planning_latency", "actuation_delay")
        faults = {
            name: UsageError(
                f"{seconds:g} s is not a multiple of the simulator's step, {dt:g} s",
                f"such as {max(round(seconds / dt), 1) * dt:g}",
            )
            for name in names
            if (seconds := getattr(self, name)) and not _is_multiple(seconds, dt)
        }
        sensor = self.sensor_period or dt
        if not faults and self.tracker_period and not _is_multiple(self.tracker_period, sensor):
            text = f"{self.tracker_period:g} s is not a multiple of sensor_period, {sensor:g} s"
            faults["tracker_period"] = UsageError(text, "leave it out to update the tracker with each frame")
        return faults


def _is_multiple(seconds: float, step: float) -> bool:
    return abs(seconds - round(seconds / step) * step) <= 1e-6 * step  # rounding


class Actuators(BaseModel):
    """Lags and limits between the planner's commands and the motion, after the delays of ``Timing``."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    acceleration_lag: _Seconds = Field(
        default=0.0, description="time constant of the acceleration, first order [s]"
    )
    turn_lag: _Seconds = Field(default=0.0, description="time constant of the yaw rate, first order [s]")
    jerk_max: _Positive | None = Field(default=None, description="bound of the acceleration's change [m/s^3]")
    power_max: _Positive | None = Field(
        default=None, description="power over mass, which bounds the acceleration at a speed [W/kg]"
    )


class Aeb(BaseModel):
    """Automatic emergency braking: when it begins, and how it brakes."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    time_to_collision: _Positive | None = Field(
        default=None, description="it begins where a vehicle in the way is nearer in time; null: not [s]"
    )
    needed_deceleration: _Positive | None = Field(
        default=7.0,
        description="it begins where more braking is needed to avoid a vehicle in the way; null: not [m/s^2]",
    )
    delay: _Seconds = Field(default=0.2, description="time from its decision to the begin of braking [s]")
    ramp: _Positive = Field(default=30.0, description="growth of its deceleration [m/s^3]")
    deceleration: _Positive = Field(default=9.0, description="greatest deceleration [m/s^2]")
    side_room: Annotated[float, Field(ge=-1.0, le=2.0)] = Field(
        default=0.0, description="room beside the ego in which a vehicle is in its way [m]"
    )

    @model_validator(mode="after")
    def _check_begin(self) -> Self:
        if self.time_to_collision is None and self.needed_deceleration is None:
            raise ValueError("it never begins: give time_to_collision, needed_deceleration or both")
        return self
