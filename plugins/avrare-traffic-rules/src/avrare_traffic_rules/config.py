"""Parameters of the traffic rules, with units and sources.

[M20] Maierhofer, Rettinger, Mayer, Althoff, "Formalization of interstate traffic rules in temporal logic",
IV 2020, and the parameters that its authors publish. [M22] Maierhofer, Moosbrugger, Althoff,
"Formalization of intersection traffic rules in temporal logic", IV 2022, read in a summary. [I24] the code
of Innes and Ramamoorthy, "Adaptive splitting of reusable temporal monitors for rare traffic violations".
[S17] Shalev-Shwartz, Shammah, Shashua, "On a formal model of safe and scalable self-driving cars", 2017; it
gives no numbers, those are the defaults of the RSS check of the simulator CARLA.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from avrare.base.errors import UsageError
from avrare.plugin import Options
from avrare_traffic_rules.rulebook import Rulebook, read, read_shipped


def _option(default: Any, unit: str, text: str, source: str, **limits: Any) -> Any:
    comparisons = {"ge": "at least", "gt": "above", "lt": "below"}
    bounds = "".join(f", {comparisons[kind]} {limit:g}" for kind, limit in limits.items())
    words = f"{text} [{unit}]{bounds}" if unit else f"{text}{bounds}"
    words += f"; {source}" if source != "ours" else ""
    extra: Any = {"unit": unit, "source": source}
    return Field(default=default, title=text, description=words, json_schema_extra=extra, **limits)


class Scales(Options):
    """Units of robustness, which make minima over different quantities meaningful."""

    longitudinal: float = Field(default=10.0, gt=0.0, description="distance along the road [m]")
    lateral: float = Field(default=1.75, gt=0.0, description="distance across the road [m]")
    speed: float = Field(default=5.0, gt=0.0, description="speed [m/s]")
    acceleration: float = Field(default=2.0, gt=0.0, description="acceleration [m/s^2]")
    heading: float = Field(default=0.1, gt=0.0, description="heading [rad]")
    time: float = Field(default=1.0, gt=0.0, description="time to collision [s]")


class Parameters(Options):
    """Parameters of rules and predicates."""

    cut_in_time: float = _option(3.0, "s", "grace after a cut-in", "[M20]; [I24] has 0.3", ge=0.0)
    reaction_time: float = _option(0.4, "s", "reaction of the one behind", "[M20]", ge=0.0)
    ego_braking: float = _option(10.0, "m/s^2", "strongest braking of the ego", "[M20]", gt=0.0)
    others_braking: float = _option(10.5, "m/s^2", "strongest braking of others", "[M20]", gt=0.0)
    abrupt_braking: float = _option(
        -2.0, "m/s^2", "acceleration below which braking is abrupt", "[M20]; [I24] has -4.75", lt=0.0
    )
    lane_limit: float | tuple[float | None, ...] | None = _option(
        None, "m/s", "speed limit, above 0: one number, or one a lane from right to left; null: none", "ours"
    )
    vehicle_type: Literal["car", "truck"] = _option("car", "", "of the ego", "ours")
    truck_limit: float = _option(22.22, "m/s", "speed limit of trucks", "[M20]", gt=0.0)
    field_of_view: float = _option(145.0, "m", "how far the ego sees", "gives the 50 m/s of [M20]", gt=0.0)
    braking_distance: float = _option(
        92.45, "m", "longest braking distance allowed", "gives the 43 m/s of [M20]", gt=0.0
    )
    speed_limit: float = _option(36.11, "m/s", "desired interstate speed", "[M20]; [I24] has 36.6", gt=0.0)
    slow_difference: float = _option(15.0, "m/s", "slower than the limit by this is slow", "[M20]", gt=0.0)
    standstill_speed: float = _option(0.01, "m/s", "slower either way is standing", "[M20]", gt=0.0)
    slightly_faster: float = _option(5.55, "m/s", "allowed past slow left traffic", "[M20]", gt=0.0)
    congestion_speed: float = _option(2.78, "m/s", "slower vehicles may form congestion", "[M20]", gt=0.0)
    congestion_size: int = _option(3, "", "vehicles ahead that make congestion", "[M20]", ge=1)
    slow_traffic_speed: float = _option(
        8.33, "m/s", "slower vehicles may form slow-moving traffic", "[M20]", gt=0.0
    )
    slow_traffic_size: int = _option(3, "", "vehicles ahead that make slow-moving traffic", "[M20]", ge=1)
    queue_speed: float = _option(16.67, "m/s", "slower vehicles may form a queue", "[M20]", gt=0.0)
    queue_size: int = _option(3, "", "vehicles ahead that make a queue", "[M20]", ge=1)
    turn_heading: float = _option(1.57, "rad", "more against the road is a U-turn", "[M20]", gt=0.0)
    broad_road: float = _option(7.0, "m", "main carriageway with room for an emergency lane", "[M20]", gt=0.0)
    border_distance: float = _option(0.2, "m", "nearer to the lane's border is kept to it", "[M20]", ge=0.0)
    beside_distance: float = _option(
        0.5, "m", "nearer to a vehicle beside is kept to it", "the authors' rule file", ge=0.0
    )
    shoulder: tuple[Annotated[int, Field(ge=0)], ...] = _option(
        (), "", "lanes of the road that are a shoulder, counted from the right, from 0", "ours"
    )
    entering_time: float = _option(5.0, "s", "within which somebody enters", "[M20]", ge=0.0)
    stop_time: float = _option(3.0, "s", "least standstill at a stop sign", "[M22]", ge=0.0)
    stop_line_distance: float = _option(
        1.0, "m", "nearer to the stop line is standing at it", "[M22]", gt=0.0
    )
    stop_speed: float = _option(0.1, "m/s", "slower either way is standing at a stop sign", "[M22]", gt=0.0)
    before_entering: float = _option(
        1.0, "s", "out of a conflict area before one with priority enters it", "[M22]", ge=0.0
    )
    after_leaving: float = _option(
        0.5, "s", "not into a conflict area after one with priority leaves it", "[M22]", ge=0.0
    )
    made_to_brake: float = _option(
        -1.0, "m/s^2", "acceleration below which one with priority is made to brake", "[M22]", lt=0.0
    )
    made_to_brake_distance: float = _option(
        15.0, "m", "from a conflict area, within which one with priority is made to brake", "[M22]", gt=0.0
    )
    yellow_braking: float = _option(
        4.0, "m/s^2", "braking with which one stops at a yellow light", "[M22]", gt=0.0
    )
    least_time_to_collision: float = _option(1.5, "s", "least time to a collision", "ours", ge=0.0)
    rss_response_time: float = _option(1.0, "s", "response time rho", "[S17], CARLA", ge=0.0)
    rss_acceleration: float = _option(3.5, "m/s^2", "most during the response", "[S17], CARLA", ge=0.0)
    rss_least_braking: float = _option(
        4.0, "m/s^2", "least of the one behind, or in a lane of the other direction", "[S17], CARLA", gt=0.0
    )
    rss_least_braking_correct: float = _option(
        3.0,
        "m/s^2",
        "least before oncoming traffic, of who is in a lane of its direction",
        "[S17], CARLA",
        gt=0.0,
    )
    rss_strongest_braking: float = _option(8.0, "m/s^2", "most of the one in front", "[S17], CARLA", gt=0.0)
    rss_lateral_acceleration: float = _option(
        0.2, "m/s^2", "most towards each other during the response", "[S17], CARLA", ge=0.0
    )
    rss_lateral_braking: float = _option(0.8, "m/s^2", "least after the response", "[S17], CARLA", gt=0.0)
    rss_lateral_margin: float = _option(0.1, "m", "left over between the two, mu", "[S17], CARLA", ge=0.0)

    @field_validator("lane_limit")
    @classmethod
    def _positive_limit(
        cls, limit: float | tuple[float | None, ...] | None
    ) -> float | tuple[float | None, ...] | None:
        for speed in limit if isinstance(limit, tuple) else (limit,):
            if speed is not None and speed <= 0.0:
                raise ValueError(f"a speed limit should be above 0, found {speed:g}")
        return limit


class TrafficRuleConfig(Parameters):
    """Options of the specification ``traffic_rules``: a rule by name, or a formula."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"rule": "R_G1"}]})

    rules_file: Path | None = Field(
        default=None,
        description="YAML file with rules of your own; default: those that come with the plugin",
        json_schema_extra={"file": True},
    )
    rule: str | None = Field(default=None, description="name of a rule")
    formula: str | None = Field(
        default=None, description="instead of a rule: a formula over predicates of vehicles"
    )
    vehicles: Literal["moving", "all"] | None = Field(
        default=None, description="which vehicles it speaks of; default: moving for R_G1, else all"
    )
    definitions: Literal["recommended", "published"] = Field(
        default="recommended",
        description="recommended: rectangles and braking distances [M20]; published: predicates and formulas "
        "of [I24], unscaled, with a band of half a lane and one car length as safe distance",
    )
    scales: Scales = Field(default_factory=Scales, description="units of robustness; not used by `published`")
    score: Literal["margin", "robustness"] = Field(
        default="margin", description="score that orders particles in splitting"
    )

    @field_validator("rule")
    @classmethod
    def _check_rule(cls, rule: str | None, info: ValidationInfo) -> str | None:
        try:
            rules = _rulebook(info.data.get("rules_file")).rules
        except UsageError:
            return rule  # reported by check.py
        if rule is not None and rule not in rules:
            expected = ", ".join(f"'{name}'" for name in rules)
            raise PydanticCustomError("literal_error", "Input should be {expected}", {"expected": expected})
        return rule

    @model_validator(mode="after")
    def _rule_or_formula(self) -> TrafficRuleConfig:
        if (self.rule is None) == (self.formula is None):
            raise ValueError("give either `rule`, a name, or `formula`, a formula")
        return self

    @property
    def rulebook(self) -> Rulebook:
        """Rules to choose from.

        Raises:
            UsageError: The rules file cannot be read or is invalid.
        """
        return _rulebook(self.rules_file)


def _rulebook(path: Path | None) -> Rulebook:
    return read_shipped() if path is None else read(path)
