"""Options of the perception error models."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from avrare.plugin import Options

_Scale = tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(ge=0)]]
_Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Share = Annotated[float, Field(ge=0, le=1)]
_Metres = Annotated[float, Field(allow_inf_nan=False)]
MOST_GHOST_SLOTS = 100


class Persistence(Options):
    """Correlation of the errors over time: lasting + (1 - lasting) exp(-seconds / time constant)."""

    detection: _Seconds = Field(
        default=0.0, description="time constant of detection [s]; misses come in bursts"
    )
    position: _Seconds = Field(default=0.0, description="time constant of both position errors [s]")
    speed: _Seconds = Field(default=0.0, description="time constant of the speed errors [s]")
    heading: _Seconds = Field(default=0.0, description="time constant of the heading errors and flips [s]")
    detection_lasting: _Share = Field(
        default=0.0, description="share of detection's variance that stays for the whole rollout [-]"
    )
    position_lasting: _Share = Field(
        default=0.0, description="share of both position errors' variance that stays likewise [-]"
    )


_Spread = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Ghosts(Options):
    """False detections, boxes without a vehicle; they need a tracker with `association: hungarian`."""

    rate: Annotated[float, Field(gt=0, allow_inf_nan=False)] = Field(
        description="false detections in a frame, in the mean [-]"
    )
    persistence: _Seconds = Field(
        default=0.0, description="time that one lasts, in the mean [s]; 0: they are drawn anew at every step"
    )
    forward: tuple[_Metres, _Metres] = Field(
        default=(0.0, 60.0), description="distance ahead of the ego where they appear, least and greatest [m]"
    )
    left: tuple[_Metres, _Metres] = Field(
        default=(-8.0, 8.0), description="distance to the left of the ego, likewise [m]"
    )
    slots: Annotated[int, Field(ge=1, le=MOST_GHOST_SLOTS)] = Field(
        default=3, description="most false detections in a frame [-]"
    )
    sd: Annotated[float, Field(ge=0, allow_inf_nan=False)] = Field(
        default=0.2, description="standard deviation of the place of one that lasts, each step anew [m]"
    )
    near: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.0,
        description="share of them that appear around a vehicle, each vehicle as likely [-]",
    )
    near_sd: tuple[_Spread, _Spread] = Field(
        default=(3.0, 1.5),
        description="standard deviations of their place around its centre, along and across it [m]",
    )
    motion: Literal["road", "ego"] = Field(
        default="road", description="they stand on the road, or move with the ego"
    )
    weather: Annotated[float, Field(ge=0, le=4)] = Field(
        default=0.0, description="power of the simulator's weather that multiplies new ones; 0: none"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.rate > 0.5 * self.slots:
            raise ValueError(
                f"rate: {self.rate:g} false detections in a frame need {2 * self.rate:g} slots or more"
            )
        for name in ("forward", "left"):
            low, high = getattr(self, name)
            if low >= high:
                raise ValueError(f"{name}: {low:g} is not below {high:g}")
        return self


class HeadingErrors(Options):
    """Errors of the reported headings."""

    flips: Annotated[float, Field(ge=0, lt=1)] = Field(
        default=0.1, description="share of headings that are half a turn off [-]"
    )
    scale: _Scale = Field(
        default=(0.03, 0.001),
        description="Student-t scale of the rest of the error: at range 0 [rad], per metre of range",
    )
    dof: Annotated[float, Field(ge=1, le=30)] = Field(
        default=3.0, description="degrees of freedom of the rest [-]"
    )


_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Deviation = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class CommonErrors(Options):
    """Error of place that all detections share, as of a calibration."""

    sd: tuple[_Deviation, _Deviation] = Field(description="standard deviations along and across the road [m]")
    time: _Positive | None = Field(
        default=None, description="time constant [s]; null: it stays for the whole rollout"
    )


class PoseErrors(Options):
    """Error of the ego's own pose, which moves all detections and the planner's belief with it."""

    sd: tuple[_Deviation, _Deviation] = Field(description="standard deviations along and across the road [m]")
    heading_sd: _Deviation = Field(default=0.0, description="standard deviation of the heading [rad]")
    time: _Positive | None = Field(
        default=None, description="time constant [s]; null: it stays for the whole rollout"
    )


class Blackouts(Options):
    """Times at which the sensor sees nothing, ghosts included."""

    rate: Annotated[float, Field(gt=0, le=1)] = Field(description="blackouts in a second of sight [1/s]")
    duration: _Positive = Field(description="mean duration of one [s]")


class _AnyPemConfig(Options):
    """Options of all models."""

    persistence: Persistence = Field(
        Persistence(), description="time constants of the errors; your assumption, no data determines them"
    )
    ghosts: Ghosts | None = Field(None, description="false detections; null: none")
    speed_y_sd: float | None = Field(
        None,
        ge=0,
        allow_inf_nan=False,
        description="standard deviation of the observed speed across the road [m/s]; null: not reported",
    )
    heading: HeadingErrors | None = Field(
        None, description="errors of the reported headings; null: no heading is reported"
    )
    common: CommonErrors | None = Field(None, description="an error common to all detections; null: none")
    pose: PoseErrors | None = Field(None, description="errors of the ego's own pose; null: it is known")
    blackouts: Blackouts | None = Field(None, description="times without any detection; null: none")


class _PemConfig(_AnyPemConfig):
    """Options of the models of a detector."""

    speed_sd: float = Field(
        0.3,
        ge=0,
        allow_inf_nan=False,
        description="standard deviation of the observed speed along the road [m/s]; 0: exact",
    )
    miss_scale: float = Field(
        1.0,
        gt=0,
        allow_inf_nan=False,
        description="factor on the odds of a miss; what if the detector were better",
    )
    error_scale: float = Field(
        1.0, gt=0, allow_inf_nan=False, description="factor on the scales of the position errors; likewise"
    )
    tail_scale: float = Field(
        1.0, gt=0, le=4, description="power of the tails of the position errors: below 1 they are lighter"
    )
    rays: int = Field(24, ge=1, le=1000, description="rays cast at each vehicle to see how much is hidden")


class GpPemConfig(_PemConfig):
    """Model fitted to a real detector."""

    persistence: Persistence | Literal["measured"] = Field(  # type: ignore[assignment]
        Persistence(),
        description="time constants of the errors, your assumption; or `measured`: those that the model has "
        "from its data (of the shipped ones, `measured` and `literal` have)",
    )

    ghosts: Ghosts | Literal["measured"] | None = Field(  # type: ignore[assignment]
        None,
        description="false detections; or `measured`: those of the model's data, where its log had any (of "
        "the shipped models none has); null: none",
    )
    heading: HeadingErrors | Literal["measured"] | None = Field(  # type: ignore[assignment]
        None,
        description="errors of the reported headings; or `measured`: those of the model's data; null: no "
        "heading is reported",
    )
    model: str = Field(
        "pointpillars",
        description="a shipped model (measured, best, paper, literal, pointpillars), or the path of an .npz",
        json_schema_extra={"file": True},
    )
    member: int = Field(
        0,
        ge=0,
        description="bootstrap refit to use, of those that `avrare pem fit --ensemble` has kept in the file; "
        "0: the model itself",
    )
    artefact: bool = Field(
        False, description="imitate the matching of the training labels, too; only for scoring on such labels"
    )
    height: float = Field(
        1.7,
        gt=0,
        allow_inf_nan=False,
        description="height of every other vehicle, an input of the model [m]",
    )

    def used_models(self) -> dict[str, Path]:
        """Return the file of a shipped model."""
        shipped = Path(__file__).parent / "models" / f"{self.model}.npz"
        return {} if self.model.endswith(".npz") else {"model": shipped}


class ParametricPemConfig(_PemConfig):
    """Closed-form model: its coefficients describe a detector and contain no data."""

    detection_plateau: float = Field(0.986, ge=0, le=1, description="detection probability at no range")
    detection_range: float = Field(51.6, description="range at which detection falls to half [m]")
    weather_range: float = Field(
        0.0,
        ge=0,
        le=4,
        description="power of the simulator's weather that divides the range; 0: weather leaves it",
    )
    detection_width: float = Field(7.6, gt=0, description="width of the fall: logistic scale [m]")
    full_visibility: float = Field(
        0.4, gt=0, le=1, description="fraction in view above which occlusion no longer matters"
    )
    longitudinal_scale: _Scale = Field(
        (0.047, 0.0060), description="Student-t scale along the vehicle: at range 0 [m], per metre of range"
    )
    lateral_scale: _Scale = Field(
        (0.024, 0.0039), description="Student-t scale across the vehicle: at range 0 [m], per metre of range"
    )
    longitudinal_dof: float = Field(2.4, ge=1, le=30, description="degrees of freedom of the error along")
    lateral_dof: float = Field(2.2, ge=1, le=30, description="degrees of freedom of the error across")
    error_limit: float = Field(8.0, gt=0, description="errors are truncated at this size along each axis [m]")


class NaivePemConfig(_AnyPemConfig):
    """Misses with a fixed probability and unit errors: a proposal for importance sampling, no detector."""

    detection: float = Field(0.5, gt=0, lt=1, description="detection probability of every vehicle")
    sd: float = Field(
        1.0, gt=0, allow_inf_nan=False, description="standard deviation of the position errors [m]"
    )
    speed_sd: float = Field(
        0.3,
        ge=0,
        allow_inf_nan=False,
        description="standard deviation of the observed speed; best as the target's [m/s]",
    )
