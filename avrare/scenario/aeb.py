"""Options of automatic emergency braking, a fallback beside any planner."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

_Seconds = Annotated[float, Field(ge=0.0, le=10.0)]
_Positive = Annotated[float, Field(gt=0.0)]


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
