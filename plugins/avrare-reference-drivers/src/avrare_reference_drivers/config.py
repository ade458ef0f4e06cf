"""Options of the controllers and of the specification. SI units; y is positive to the left."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

from pydantic import Field, field_validator

from avrare.plugin import Options

Model = Literal["cc", "cc_lane", "reg157", "rss", "fsm"]
TtcReading = Literal["settled", "waits"]


class _Lateral(Options):
    y_goal: float | None = Field(
        default=None,
        description="lateral position that it keeps [m]; default: the centre of the nearest lane",
    )


class ReferenceDriverConfig(_Lateral):
    """Options of the controller ``reference_driver``."""

    model: Model = Field(
        default="cc",
        description="careful human driver (cc), the same who knows the lanes (cc_lane), a system that "
        "just meets R157 5.2.5.2 (reg157), responsibility-sensitive safety (rss), fuzzy safety (fsm)",
    )
    sees: Literal["truth", "track"] = Field(
        default="truth", description="the others' true states, or the tracker's estimates"
    )
    ttc_reading: TtcReading = Field(
        default="settled",
        description="for cc and cc_lane, while the time to collision is above 2 s: it keeps its distance to "
        "the car in its lane (settled), or drives on (waits)",
    )
    follows: bool = Field(
        default=True,
        description="whether it keeps its distance to the car in its lane once it has reacted; else it keeps "
        "the speed that is left, as in JRC's grids",
    )


class CruiseConfig(_Lateral):
    """Options of the controller ``cruise``."""

    set_speed: float | None = Field(
        default=None, ge=0.0, description="speed on a free road [m/s]; default: that of the start"
    )
    acceleration: float = Field(default=1.5, gt=0.0, description="bound of its acceleration [m/s^2]")
    braking: float = Field(default=3.0, gt=0.0, description="bound of its braking behind others [m/s^2]")
    gap_gain: float = Field(default=0.2, gt=0.0, description="acceleration per metre of gap [1/s^2]")
    speed_gain: float = Field(default=0.8, gt=0.0, description="acceleration per m/s of speed [1/s]")
    margin: float = Field(default=0.3, description="free gap across below which it follows a vehicle [m]")


class HoldConfig(_Lateral):
    """Options of the controller ``hold``."""

    speed: float | None = Field(default=None, ge=0.0, description="speed [m/s]; default: that of the start")
    acceleration: float = Field(default=2.0, gt=0.0, description="bound of |acceleration| towards it [m/s^2]")
    path: tuple[tuple[float, float], ...] = Field(
        default=(), description="x and y of the points of its path [m]; default: its lane"
    )
    lookahead: float = Field(default=6.0, gt=0.0, description="distance of the point that it steers to [m]")

    @field_validator("path")
    @classmethod
    def _distinct(cls, path: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        if len(path) == 1 or any(first == second for first, second in pairwise(path)):
            raise ValueError("give two points or more; consecutive ones must differ")
        return path


class AvoidableCollisionConfig(Options):
    """Options of the specification ``avoidable_collision``."""

    standing_passengers: bool = Field(
        default=False, description="the bound of vehicles with standing passengers, which brake gently"
    )
    intrusion: float = Field(
        default=0.3, ge=0.0, description="way into the ego's lane from which the time is counted [m]"
    )
