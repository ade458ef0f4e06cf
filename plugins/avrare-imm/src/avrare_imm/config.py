"""Options of the tracker."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Probability = Annotated[float, Field(gt=0, lt=1)]
Steps = Annotated[int, Field(ge=1, le=60)]


class ImmConfig(BaseModel):
    """Model sets, noise and prior of the interacting-multiple-model tracker, and the life of its tracks.

    The lateral reference lanes are the lane centres of the scene's road.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    longitudinal_models: tuple[Literal["cv", "ca"], ...] = Field(
        ("cv", "ca"),
        min_length=1,
        description="Motion along the road: constant velocity (cv), constant acceleration (ca)",
    )
    derivative_gains: tuple[Positive, ...] = Field(
        (3.0, 4.0, 5.0),
        min_length=1,
        description="Damping of the lane-seeking drivers, one lateral model per gain and lane [1/s]",
    )
    proportional_gain: Positive = Field(
        7.0, description="Stiffness of the lane-seeking drivers towards their lane [1/s^2]"
    )
    longitudinal_noise: Positive = Field(
        1.0, description="Variance of the random acceleration along the road, one draw a step [(m/s^2)^2]"
    )
    lateral_noise: Positive = Field(
        0.1, description="Variance of the random acceleration across the road, one draw a step [(m/s^2)^2]"
    )
    position_variance: Positive = Field(0.1, description="Measurement variance of x [m^2]")
    speed_variance: Positive = Field(0.1, description="Measurement variance of the speed along x [(m/s)^2]")
    lateral_variance: Positive = Field(0.1, description="Measurement variance of y [m^2]")
    stay_probability: Probability = Field(
        0.95, description="Probability that a mode is kept for one step; the rest is shared by the others [-]"
    )
    initial_variance: Positive = Field(
        1.0, description="Variance of every state component at the start [m^2, (m/s)^2, (m/s^2)^2]"
    )
    lane_tolerance: Positive = Field(
        0.05, description="A vehicle this near to a lane centre starts in that lane [m]"
    )
    lane_match_weight: Positive = Field(
        0.9, description="Prior weight, before normalisation, of each model of the starting lane [-]"
    )
    lane_other_weight: Positive = Field(
        0.1, description="Prior weight, before normalisation, of each model of another lane [-]"
    )
    velocity: Literal["noisy", "none"] = Field(
        "noisy",
        description="noisy: perception's speed along the road is measured, too; none: positions only, the "
        "tracker estimates all velocities",
    )
    gate: Positive | None = Field(
        None,
        description="A detection farther than this from its prediction counts as a miss [standard deviations "
        "of the innovation]; null: no gate",
    )
    start: Literal["truth", "empty"] = Field(
        "truth",
        description="Tracks at t = 0: the true world, or none, so that vehicles must be detected first",
    )
    birth: tuple[Steps, Steps] = Field(
        (2, 3), description="(m, n): a vehicle without a track gets one after m detections within n steps"
    )
    death: Steps | None = Field(
        None, description="A track ends after this many misses in a row; null: it is predicted forever"
    )
    birth_speed_sd: Positive = Field(
        20.0,
        description="Standard deviation of the speed along the road at the first detection where velocity is "
        "none; its mean is 0 [m/s]",
    )

    @model_validator(mode="after")
    def _check_birth(self) -> Self:
        least, of = self.birth
        if least > of:
            raise ValueError(f"birth: {least} detections within {of} steps are impossible")
        return self
