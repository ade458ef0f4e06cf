"""Options of the tracker."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from avrare.plugin import Options

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Probability = Annotated[float, Field(gt=0, lt=1)]
Steps = Annotated[int, Field(ge=1, le=60)]


class ImmConfig(Options):
    """Model sets, noise and prior of the interacting-multiple-model tracker, and the life of its tracks.

    The lateral reference lanes are the lane centres of the scene's road.
    """

    longitudinal_models: tuple[Literal["cv", "ca", "stand"], ...] = Field(
        ("cv", "ca", "stand"),
        min_length=1,
        description="Motion along the road: constant velocity (cv), constant acceleration (ca), none, across "
        "the road neither (stand)",
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
    lateral_speed: Literal["none", "velocity", "heading"] = Field(
        "none",
        description="Measurement of the speed across the road: none; the reported velocity; or the tangent "
        "of the reported heading, 45 degrees at most, times the speed along the road",
    )
    lateral_speed_variance: Positive = Field(
        0.1, description="Measurement variance of the speed across the road, where it is one [(m/s)^2]"
    )
    gate: Positive | None = Field(
        None,
        description="A detection farther than this from its prediction counts as a miss [standard deviations "
        "of the innovation]; null: no gate",
    )
    restart: Steps | None = Field(
        3,
        description="With a gate: a track begins anew at the last of so many detections beyond the gate, "
        "none within it between them; null: it does not",
    )
    association: Literal["labelled", "hungarian"] = Field(
        "labelled",
        description="Which detection belongs to which track: given (labelled), or by the most probable "
        "assignment within the gate (hungarian), so that detections may be swapped and false",
    )
    spare_tracks: Annotated[int, Field(ge=0, le=20)] = Field(
        4, description="hungarian: tracks that may exist beyond the number of vehicles [-]"
    )
    start: Literal["burn_in", "empty", "truth"] = Field(
        "burn_in",
        description="Tracks at t = 0: from detections before it (burn_in); none, so that vehicles must be "
        "detected first (empty); or the true world (truth)",
    )
    burn_in: Annotated[float, Field(gt=0, le=60, allow_inf_nan=False)] = Field(
        3.0, description="Time before t = 0 that the tracker has observed, with start: burn_in [s]"
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
    def _check_models(self) -> Self:
        if len(set(self.longitudinal_models)) < len(self.longitudinal_models):
            raise ValueError("longitudinal_models: a model is named twice")
        if set(self.longitudinal_models) == {"stand"}:
            raise ValueError("longitudinal_models: a vehicle that moves needs cv or ca")
        return self

    @model_validator(mode="after")
    def _check_birth(self) -> Self:
        least, of = self.birth
        if least > of:
            raise ValueError(f"birth: {least} detections within {of} steps are impossible")
        return self

    @model_validator(mode="after")
    def _check_association(self) -> Self:
        lacking = [name for name in ("gate", "death") if getattr(self, name) is None]
        if self.association == "hungarian" and lacking:
            raise ValueError(
                f"association: hungarian needs {' and '.join(lacking)}: without a gate any detection fits "
                "any track, and without a death false tracks stay; for example gate: 4, death: 10"
            )
        default = type(self).model_fields["spare_tracks"].default
        if self.association == "labelled" and self.spare_tracks != default:  # a resolved scenario has it
            raise ValueError("spare_tracks: only association: hungarian has any")
        return self
