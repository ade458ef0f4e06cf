"""Parameters of the traffic rules, with units and sources.

[M20] Maierhofer, Rettinger, Mayer, Althoff, "Formalization of interstate traffic rules in temporal logic",
IV 2020, and the parameters that its authors publish. [I24] the code of Innes and Ramamoorthy, "Adaptive
splitting of reusable temporal monitors for rare traffic violations".
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

RuleName = Literal["R_G1", "R_G2", "R_G4", "R_I2", "no_collision"]


class Scales(BaseModel):
    """What counts as one unit of robustness, so that minima over unlike quantities make sense."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    longitudinal: float = Field(default=10.0, gt=0.0, description="distance along the road [m]")
    lateral: float = Field(default=1.75, gt=0.0, description="distance across the road [m]")
    speed: float = Field(default=5.0, gt=0.0, description="speed [m/s]")
    acceleration: float = Field(default=2.0, gt=0.0, description="acceleration [m/s^2]")
    heading: float = Field(default=0.1, gt=0.0, description="heading [rad]")


class TrafficRuleConfig(BaseModel):
    """Options of the specification ``traffic_rules``."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    rule: RuleName = Field(description="which rule")
    vehicles: Literal["moving", "all"] | None = Field(
        default=None, description="which vehicles it speaks of; default: moving for R_G1, else all"
    )
    definitions: Literal["recommended", "published"] = Field(
        default="recommended",
        description="recommended: rectangles and braking distances [M20]; published: predicates and formulas "
        "of [I24], unscaled, with a band of half a lane and one car length as safe distance",
    )
    cut_in_time: float = Field(
        default=3.0, ge=0.0, description="grace after a cut-in [s] [M20]; [I24] has 0.3"
    )
    reaction_time: float = Field(default=0.4, ge=0.0, description="of the ego [s] [M20]")
    ego_braking: float = Field(default=10.0, gt=0.0, description="strongest braking of the ego [m/s^2] [M20]")
    others_braking: float = Field(
        default=10.5, gt=0.0, description="strongest braking of others [m/s^2] [M20]"
    )
    abrupt_braking: float = Field(
        default=-2.0,
        lt=0.0,
        description="acceleration below which braking is abrupt [m/s^2] [M20]; [I24] has -4.75",
    )
    speed_limit: float = Field(
        default=36.11, gt=0.0, description="desired interstate speed [m/s] [M20]; [I24] has 36.6"
    )
    slow_difference: float = Field(
        default=15.0, gt=0.0, description="slower than the limit by this is slow [m/s] [M20]"
    )
    slightly_faster: float = Field(
        default=5.55, gt=0.0, description="allowed past slow left traffic [m/s] [M20]"
    )
    queue_speed: float = Field(
        default=16.67, gt=0.0, description="slower vehicles may form a queue [m/s] [M20]"
    )
    queue_size: int = Field(default=3, ge=1, description="vehicles ahead that make a queue [M20]")
    scales: Scales = Field(default_factory=Scales, description="units of robustness; not used by `published`")
    score: Literal["margin", "robustness"] = Field(
        default="margin", description="what orders particles in splitting"
    )
