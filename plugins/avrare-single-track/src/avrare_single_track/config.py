"""Options of road, ego and traffic. SI units; y is positive to the left."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Generic, Literal, Self, TypeVar

from pydantic import ConfigDict, Field, field_validator, model_validator

from avrare.plugin import Drawable, Options
from avrare_mpc.config import TrajectoryPlan

_Lane = Annotated[int, Field(ge=0)]
_Station = Annotated[float, Field(gt=-1e5, lt=1e5)]
"""x on a road; lanes without an end have theirs beyond (``avrare.driving.lanes.ENDLESS``) [m]."""
_Number = TypeVar("_Number", bound=float)
AfterImpact = Literal["end", "go_on"]
AFTER_IMPACT = (
    "consequence where the ego touches a vehicle: the drive ends, and later samples count for nothing; or "
    "it continues through the vehicle, with contacts between two samples unseen"
)
MOST_REACTION = 3.0
"""Longest reaction time of a driver [s]."""


class PieceConfig(Options):
    """Straight, arc or clothoid of a road's reference line."""

    length: float = Field(gt=0.0, description="[m]")
    curvature: float = Field(default=0.0, description="at its begin, 1 / radius, positive to the left [1/m]")
    end_curvature: float | None = Field(
        default=None, description="at its end; it changes linearly; default: an arc or a straight [1/m]"
    )


class SpanConfig(Options):
    """Stretch of the road at which there is a lane."""

    lane: int = Field(ge=0, description="index of the lane, from the right")
    begin: _Station | None = Field(default=None, description="x at which it begins; default: it does not [m]")
    end: _Station | None = Field(default=None, description="x at which it ends; default: it does not [m]")

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.begin is None and self.end is None:
            raise ValueError("give begin, end or both")
        if self.begin is not None and self.end is not None and self.begin >= self.end:
            raise ValueError("a lane must begin before it ends")
        return self


class RoadConfig(Options):
    """Parallel lanes along x, or along a line that bends."""

    lane_centres: tuple[float, ...] = Field(
        default=(-1.75, 1.75, 5.25), min_length=1, description="y of the lane centres, from right to left [m]"
    )
    lane_width: float = Field(default=3.5, gt=0.0, description="width of every lane [m]")
    access_ramp: tuple[int, ...] = Field(default=(), description="indices of the lanes of an access ramp")
    line: tuple[PieceConfig, ...] = Field(
        default=(),
        max_length=1000,
        description="pieces of the reference line from x = 0 on, straight before and beyond; x then is the "
        "length along it, y the distance to its left, headings are against it; default: straight",
    )
    broad_markings: tuple[int, ...] = Field(
        default=(), description="indices of the lanes whose left border is a broad marking"
    )
    lane_spans: tuple[SpanConfig, ...] = Field(
        default=(), description="lanes that begin or end, such as an access ramp; others have no ends"
    )
    opposing: tuple[int, ...] = Field(
        default=(), description="indices of the lanes whose traffic comes towards the ego"
    )
    begin: float = Field(default=0.0, description="first x that is drawn [m]")
    end: float = Field(default=160.0, description="last x that is drawn [m]")

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        if list(self.lane_centres) != sorted(set(self.lane_centres)):
            raise ValueError("lane_centres must ascend: the rightmost lane first")
        if any(b - a < self.lane_width - 1e-9 for a, b in pairwise(self.lane_centres)):
            raise ValueError("the lanes overlap: lane_width is more than the distance of their centres")
        spans = [span.lane for span in self.lane_spans]
        if len(set(spans)) < len(spans):
            raise ValueError("lane_spans names a lane twice")
        for name in ("access_ramp", "broad_markings", "opposing", "lane_spans"):
            lanes = spans if name == "lane_spans" else getattr(self, name)
            if any(not 0 <= lane < len(self.lane_centres) for lane in lanes):
                raise ValueError(f"{name} must name lanes 0..{len(self.lane_centres) - 1}")
        if self.opposing and max(self.opposing) - min(self.opposing) + 1 != len(set(self.opposing)):
            raise ValueError("the opposing lanes must lie side by side")
        half = 0.5 * self.lane_width
        for piece in self.line:
            for curvature in (piece.curvature, piece.end_curvature or 0.0):
                if (
                    max(curvature * (self.lane_centres[-1] + half), curvature * (self.lane_centres[0] - half))
                    > 0.5
                ):
                    raise ValueError(
                        f"a lane reaches half the way to the centre of a bend of {1.0 / abs(curvature):.4g} m"
                    )
        return self


class EgoConfig(Options):
    """Start and body of the ego; the defaults are a mid-size car (CommonRoad vehicle 1)."""

    x: Drawable = Field(description="centre at the start [m]")
    y: Drawable = Field(description="centre at the start [m]")
    speed: Drawable = Field(ge=0.0, description="at the start [m/s]")
    heading: Drawable = Field(default=0.0, description="at the start [rad]")
    length: float = Field(default=4.298, gt=0.0, description="[m]")
    width: float = Field(default=1.674, gt=0.0, description="[m]")
    wheelbase: float = Field(default=2.391, gt=0.0, description="distance of the axles [m]")
    steering_max: float = Field(default=0.91, gt=0.0, lt=1.5, description="bound of |steering angle| [rad]")
    steering_rate_max: float = Field(default=0.4, gt=0.0, description="bound of its rate [rad/s]")
    acceleration_max: float = Field(default=11.5, gt=0.0, description="bound of |acceleration| [m/s^2]")
    speed_max: float = Field(default=45.8, gt=0.0, description="top speed [m/s]; the plant never reverses")
    friction: Drawable | None = Field(
        default=None,
        gt=0.0,
        description="friction coefficient, which bounds the combined acceleration, in 9.81 m/s^2",
    )

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        if self.speed > self.speed_max:
            raise ValueError("speed must not be above speed_max")
        return self


class MergeConfig(Options):
    """Options of a driver who changes to another lane as soon as the gaps are safe."""

    lane: int = Field(ge=0, description="index of the lane, from the right")
    from_step: int = Field(default=0, ge=0, description="first step at which it is wanted")


class BrakeConfig(Options):
    """Steps, first and last included, at which a driver brakes whatever is ahead."""

    from_step: int = Field(ge=0, description="first step")
    to_step: int = Field(ge=0, description="last step")
    acceleration: float = Field(
        le=0.0, description="acceleration, or less where the model brakes harder [m/s^2]"
    )

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.from_step > self.to_step:
            raise ValueError("from_step must not be above to_step")
        return self


def _number(default: float, description: str, **bounds: Any) -> Any:
    return Field(default=default, description=description, **bounds)


class FollowingConfig(Options, Generic[_Number]):
    """Car following of a driver, its reaction time, and the noise of both."""

    time_gap: _Number = _number(1.5, "time gap to the vehicle ahead [s]", ge=0.0)
    standstill_gap: _Number = _number(2.0, "gap to it at rest, bumper to bumper [m]", gt=0.0)
    acceleration: _Number = _number(1.5, "acceleration on a free road [m/s^2]", gt=0.0)
    deceleration: _Number = _number(2.0, "comfortable deceleration [m/s^2]", gt=0.0)
    braking_max: _Number = _number(8.0, "bound of the deceleration [m/s^2]", gt=0.0)
    coolness: _Number = _number(
        0.0, "share of calm braking for a gap that closes slowly, as after a cut-in; 0: IDM", ge=0.0, le=1.0
    )
    acceleration_sd: float = _number(
        0.0, "standard deviation of the noise of its acceleration [m/s^2]", ge=0.0
    )
    reaction_time: _Number = _number(
        0.0,
        "time from a driver's observation to its acceleration [s]",
        ge=0.0,
        le=MOST_REACTION,
    )
    reaction_sd: float = _number(0.0, "standard deviation of log(reaction time)", ge=0.0, le=1.0)
    correlation_time: float = _number(1.0, "correlation time of these noises [s]", gt=0.0)

    @model_validator(mode="after")
    def _spread(self) -> Self:
        if self.reaction_sd > 0.0 and self.reaction_time == 0.0:
            raise ValueError("reaction_sd spreads a reaction_time above 0: give one")
        return self


class DriverConfig(FollowingConfig[Drawable]):
    """Driver that reacts to all vehicles: IDM along the road, MOBIL and gap acceptance across it."""

    desired_speed: Drawable = Field(ge=0.0, description="speed on a free road; 0: it stops and stands [m/s]")
    lane_changes: bool = Field(default=True, description="change lanes where it pays (MOBIL)")
    lanes: tuple[_Lane, _Lane] | None = Field(
        default=None, description="first and last lane to choose from; default: all of the road"
    )
    politeness: Drawable = Field(default=0.3, ge=0.0, description="weight of the followers' gains and losses")
    gain: Drawable = Field(default=0.2, description="least gain of a lane change [m/s^2]")
    safe_braking: Drawable = Field(
        default=3.0, gt=0.0, description="deceleration that a change may impose on anybody [m/s^2]"
    )
    lane_change_time: Drawable = Field(default=3.0, gt=0.0, description="duration of a lane change [s]")
    merge: MergeConfig | None = Field(default=None, description="a change that is wanted whatever it gains")
    lane_end: float | None = Field(
        default=None, description="x at which the lane of its start ends, where it stops otherwise [m]"
    )
    brake: tuple[BrakeConfig, ...] = Field(default=(), description="scripted braking")

    @field_validator("lanes")
    @classmethod
    def _check_order(cls, lanes: tuple[int, int] | None) -> tuple[int, int] | None:
        if lanes is not None and lanes[0] > lanes[1]:
            raise ValueError("the first lane must not be above the last one")
        return lanes


class VehicleConfig(Options):
    """Other vehicle: parked, at constant velocity, following a plan made before the run, or reacting."""

    name: str = Field(min_length=1, description="as it is called in messages and pictures")
    x: Drawable = Field(description="centre at the start [m]")
    y: Drawable = Field(description="centre at the start [m]")
    speed: Drawable = Field(default=0.0, ge=0.0, description="at the start [m/s]")
    heading: float = Field(default=0.0, description="at the start [rad]")
    length: float = Field(default=4.298, gt=0.0, description="[m]")
    width: float = Field(default=1.674, gt=0.0, description="[m]")
    drive: TrajectoryPlan | None = Field(
        default=None, description="goals of the planner that scripts it; without: constant velocity"
    )

    driver: DriverConfig | None = Field(default=None, description="driver that reacts to the other vehicles")

    @model_validator(mode="after")
    def _check_driver(self) -> Self:
        if self.drive is not None and self.driver is not None:
            raise ValueError(f"{self.name!r} follows a script (drive) or reacts (driver), not both")
        return self

    @field_validator("name")
    @classmethod
    def _refuse_reserved(cls, name: str) -> str:
        if name in ("ego", "others"):
            raise ValueError(f"{name!r} is a reserved name in formulas: give the vehicle another name")
        return name


class SingleTrackConfig(Options):
    """Options of the simulator ``single_track``."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"ego": {"x": 0.0, "y": 1.75, "speed": 20.0}}]})

    dt: float = Field(default=0.1, gt=0.0, le=1.0, description="step [s]")
    substeps: int = Field(
        default=1, ge=1, le=100, description="integration steps of the ego and of drivers within a step"
    )
    road: RoadConfig = Field(default_factory=RoadConfig, description="lanes")
    ego: EgoConfig = Field(description="the vehicle under test, such as {x: 0, y: 0, speed: 30}")
    vehicles: tuple[VehicleConfig, ...] = Field(
        default=(), max_length=1000, description="the other vehicles; leave out those that stay far away"
    )

    weather: Drawable | None = Field(
        default=None,
        gt=0.0,
        description="factor on the errors of perception and on the odds of a miss; 1: as the perception "
        "error model was fitted",
    )
    after_impact: AfterImpact = Field(default="end", description=AFTER_IMPACT)

    @model_validator(mode="after")
    def _check_distinct_names(self) -> Self:
        names = [vehicle.name for vehicle in self.vehicles]
        if len(set(names)) != len(names):
            raise ValueError("every vehicle needs a name of its own")
        return self

    @model_validator(mode="after")
    def _check_lanes(self) -> Self:
        count = len(self.road.lane_centres)
        for vehicle in self.vehicles:
            drive = vehicle.drive
            driver = vehicle.driver
            last = max((*drive.lanes, *drive.fixed_lanes().values())) if drive else 0
            last = (
                max((last, *(driver.lanes or ()), driver.merge.lane if driver.merge else 0))
                if driver
                else last
            )
            if last >= count:
                raise ValueError(f"{vehicle.name!r} drives on lane {last}, the lanes are 0..{count - 1}")
        return self
