"""Reading of conditions."""

from __future__ import annotations

from dataclasses import replace

from avrare_openscenario.action_reader import ActionReader
from avrare_openscenario.parameters import Number
from avrare_openscenario.story import EDGES, RULES, Condition, Direction, Place, Rule
from avrare_openscenario.xml_tree import Element

_LONGEST_DELAY = 100_000
"""Longest delay of a condition [steps]."""
_MANY_LANES = 1_000
_MEASURES = {
    "SpeedCondition": "speed",
    "RelativeSpeedCondition": "relative_speed",
    "AccelerationCondition": "acceleration",
}
_DISTANCES = ("longitudinal", "lateral", "cartesianDistance", "euclidianDistance")
_SYSTEMS = ("entity", "lane", "road", "trajectory", "world")


class ConditionReader:
    """Reader of the conditions of one file.

    Args:
        actions: Reader of its actions, and of what they refer to.
        dt: Step [s].
    """

    def __init__(self, actions: ActionReader, dt: float) -> None:
        self.actions, self.parameters, self.dt = actions, actions.parameters, dt

    def read(self, condition: Element) -> Condition:
        """Read a ``Condition``."""
        condition.get("name")
        edge = self.parameters.choose(condition, "conditionEdge", EDGES, "none")
        delay = 0 if condition.get("delay") is None else self._read_steps(condition, "delay")
        kind = condition.choice("ByValueCondition", "ByEntityCondition")
        if kind.tag == "ByValueCondition":
            found = self._read_by_value(kind.choice())
        else:
            found = self._read_by_entity(kind)
        return replace(found, edge=edge, delay=found.delay + delay)

    def _read_by_value(self, one: Element) -> Condition:
        match one.tag:
            case "SimulationTimeCondition":
                return Condition("time", *self._read_comparison(one))
            case "StoryboardElementStateCondition":  # resolved when all elements are read
                return Condition("state", "equalTo", self.parameters.constant(0.0))
            case "ParameterCondition" | "VariableCondition":
                variable = self.actions.find_variable(one)
                rule, value = self.parameters.choose(one, "rule", RULES), self.parameters.value(one, "value")
                return Condition("variable", rule, value, variable=variable)
            case "TrafficSignalCondition" | "TrafficSignalControllerCondition":
                return self.actions.lights.read_condition(one)
            case "UserDefinedValueCondition":
                one.pass_over("is never met: nothing outside the file sets values")
                return Condition("time", "lessThan", self.parameters.constant(-1.0))
        raise one.error("is not read", "see docs/openscenario.md")

    def _read_comparison(self, one: Element) -> tuple[Rule, Number]:
        return self.parameters.choose(one, "rule", RULES), self.parameters.number(one, "value")

    def _read_by_entity(self, condition: Element) -> Condition:
        triggering = condition.child("TriggeringEntities")
        entities = self.actions.find_entities(triggering)
        amount = self.parameters.choose(triggering, "triggeringEntitiesRule", ("any", "all"))
        if not entities:
            raise triggering.error("names no entities")
        found = self._read_entity_condition(condition.child("EntityCondition").choice())
        return replace(found, entities=entities, every=amount == "all")

    def _read_entity_condition(self, one: Element) -> Condition:
        match one.tag:
            case "SpeedCondition" | "RelativeSpeedCondition" | "AccelerationCondition":
                rule, value = self._read_comparison(one)
                kind = _MEASURES[one.tag]
                other = self.actions.find_entity(one) if kind == "relative_speed" else -1
                return Condition(kind, rule, value, other=other, direction=self._read_direction(one))
            case "TraveledDistanceCondition":
                return Condition("travelled", "greaterOrEqual", self.parameters.number(one, "value"))
            case "StandStillCondition":
                return Condition("standstill", "greaterOrEqual", self.parameters.number(one, "duration"))
            case "TimeHeadwayCondition" | "RelativeDistanceCondition":
                kind = "headway" if one.tag == "TimeHeadwayCondition" else "distance"
                return replace(self._read_distance(one, kind), other=self.actions.find_entity(one))
            case "DistanceCondition":
                return replace(self._read_distance(one, "distance"), place=self._place(one))
            case "TimeToCollisionCondition":
                return self._read_collision_time(one)
            case "ReachPositionCondition":
                tolerance = self.parameters.number(one, "tolerance")
                return Condition("reach", "lessOrEqual", tolerance, along=False, place=self._place(one))
            case "CollisionCondition":
                return replace(self._ask("collision"), against=self._read_against(one))
            case "RelativeClearanceCondition":
                return self._read_clearance(one)
            case "EndOfRoadCondition" | "OffroadCondition":
                kind = "road_end" if one.tag == "EndOfRoadCondition" else "off_road"
                return replace(self._ask(kind), delay=self._read_steps(one, "duration"))
            case "AngleCondition" | "RelativeAngleCondition":
                return self._read_angle(one)
        raise one.error("is not read", "see docs/openscenario.md")

    def _ask(self, kind: str) -> Condition:
        # Condition that holds where what is measured is 1.
        return Condition(kind, "equalTo", self.parameters.constant(1.0))

    def _read_angle(self, one: Element) -> Condition:
        # Whether a heading is within a tolerance of an angle.
        self.parameters.choose(one, "angleType", ("heading",))  # roads are flat
        relative = one.tag == "RelativeAngleCondition"
        frames = ("entity", "lane") if relative else ("world", "road", "lane")
        frame = self.parameters.choose(one, "coordinateSystem", frames, frames[0])
        other = self.actions.find_entity(one) if relative else -1
        angle, limit = (self.parameters.number(one, name) for name in ("angle", "angleTolerance"))
        along = frame in ("road", "lane")
        return Condition("angle", "lessOrEqual", limit, other=other, along=along, reach=(angle,))

    def _read_collision_time(self, one: Element) -> Condition:
        found = self._read_distance(one, "collision_time")
        if not found.along:
            raise one.error(
                "a time to collision is read along the road", 'relativeDistanceType="longitudinal"'
            )
        one.note("is taken along the road, also to vehicles in other lanes")
        target = one.child("TimeToCollisionConditionTarget").choice("EntityRef", "Position")
        if target.tag == "Position":
            return replace(found, place=self.actions.read_place(target))
        return replace(found, other=self.actions.find_entity(target))

    def _read_clearance(self, one: Element) -> Condition:
        # Whether no other vehicle is within a way ahead and behind, in some lanes.
        reach = tuple(
            self.parameters.number(one, name, 0.0) for name in ("distanceForward", "distanceBackward")
        )
        if self.parameters.boolean(one, "oppositeLanes"):
            one.note("vehicles in opposing lanes count where the lanes do")
        lanes = []
        for span in one.list("RelativeLaneRange"):
            low, high = (
                limit if span.get(name) is None else self.parameters.whole(span, name)
                for name, limit in (("from", -_MANY_LANES), ("to", _MANY_LANES))
            )
            lanes.append((low, high))
        return replace(
            self._ask("clearance"),
            free=self.parameters.boolean(one, "freeSpace"),
            against=self.actions.find_entities(one) or tuple(range(len(self.actions.kinds))),
            reach=reach,
            lanes=tuple(lanes),
        )

    def _place(self, one: Element) -> Place:
        return self.actions.read_place(one.child("Position"))

    def _read_direction(self, one: Element) -> Direction:
        choices: tuple[Direction, ...] = ("longitudinal", "lateral")
        count = 2 if one.tag == "RelativeSpeedCondition" else 1
        return self.parameters.choose(one, "direction", choices[:count], "")

    def _read_against(self, one: Element) -> tuple[int, ...]:
        # Entities that a collision is with.
        target = one.choice("EntityRef", "ByType", "ByObjectType")
        if target.tag == "EntityRef":
            return self.actions.find_members(target)
        return self.actions.find_type(target)

    def _read_distance(self, one: Element, kind: str) -> Condition:
        # Condition on a distance, without what it is to.
        rule, value = self._read_comparison(one)
        along = self.parameters.boolean(one, "alongRoute") or kind == "collision_time"
        default = "longitudinal" if along else "euclidianDistance"
        way = self.parameters.choose(one, "relativeDistanceType", _DISTANCES, default)
        self.parameters.choose(one, "coordinateSystem", _SYSTEMS, "entity")
        one.get("routingAlgorithm")
        one.attribute("freespace")
        free = self.parameters.boolean(one, "freespace")
        side: Direction = "lateral" if way == "lateral" else ""
        return Condition(kind, rule, value, along=way == "longitudinal", free=free, direction=side)

    def _read_steps(self, element: Element, name: str) -> int:
        # A time, as a number of steps.
        seconds = self.parameters.fixed(element, name)
        if not 0.0 <= seconds <= _LONGEST_DELAY * self.dt:
            text = f"{name} should be a time from 0 to {_LONGEST_DELAY} steps, found {seconds:g}"
            raise element.error(text)
        return round(seconds / self.dt)
