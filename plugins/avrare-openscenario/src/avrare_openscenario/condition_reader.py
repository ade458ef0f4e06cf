"""Reading of conditions."""

from __future__ import annotations

from dataclasses import replace

from avrare_openscenario.action_reader import ActionReader
from avrare_openscenario.parameters import Number
from avrare_openscenario.signals import Controller
from avrare_openscenario.story import EDGES, RULES, Condition, Direction, Place, Rule
from avrare_openscenario.xml_tree import Element

_LONGEST_DELAY = 100_000
"""Longest delay of a condition [steps]."""
_MANY_LANES = 1_000
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
        seconds = 0.0 if condition.get("delay") is None else self.parameters.fixed(condition, "delay")
        if not 0.0 <= seconds <= _LONGEST_DELAY * self.dt:
            text = f"delay should be a time from 0 to {_LONGEST_DELAY} steps, found {seconds:g}"
            raise condition.error(text)
        kind = condition.choice()
        if kind.tag == "ByValueCondition":
            found = self._read_by_value(kind.choice())
        elif kind.tag == "ByEntityCondition":
            found = self._read_by_entity(kind)
        else:
            raise kind.unknown("ByValueCondition, ByEntityCondition")
        return replace(found, edge=edge, delay=found.delay + round(seconds / self.dt))

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
            case "TrafficSignalCondition":
                light, every = self.parameters.text(one, "name"), self.actions.controllers
                owners = (owner for owner in every if any(light in shown for *_, shown in owner.phases))
                return self._read_light(one, "state", light, next(owners, None))
            case "TrafficSignalControllerCondition":
                return self._read_light(one, "phase", "", self.actions.find_controller(one))
            case "UserDefinedValueCondition":
                one.pass_over("is never met: nothing outside the file sets values")
                return Condition("time", "lessThan", self.parameters.constant(-1.0))
        known = "SimulationTimeCondition, StoryboardElementStateCondition, ParameterCondition"
        raise one.unknown(f"{known}, VariableCondition, TrafficSignalCondition")

    def _read_light(self, one: Element, name: str, light: str, owner: Controller | None) -> Condition:
        # Whether a light shows a state, as an action or the phase of its controller has it.
        variable, value = self.actions.find_light(light), self.parameters.value(one, name)
        if owner is None:
            return Condition("variable", "equalTo", value, variable=variable)
        spans, cycle = owner.list_spans(light, self.parameters.text(one, name)), owner.phases[-1][1]
        times = (cycle, *(time for span in spans for time in span))
        reach, clock = tuple(map(self.parameters.constant, times)), self.actions.find_clock(owner)
        return Condition("light", "equalTo", value, variable=variable, other=clock, reach=reach)

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
        simple = {
            "TraveledDistanceCondition": "travelled",
            "SpeedCondition": "speed",
            "RelativeSpeedCondition": "relative_speed",
            "AccelerationCondition": "acceleration",
            "TimeHeadwayCondition": "headway",
            "RelativeDistanceCondition": "distance",
        }
        if one.tag == "TraveledDistanceCondition":
            return Condition("travelled", "greaterOrEqual", self.parameters.number(one, "value"))
        if one.tag in simple:
            rule, value = self._read_comparison(one)
            kind, along, free = simple[one.tag], True, False
            other = self.actions.find_entity(one) if kind in ("relative_speed", "headway", "distance") else -1
            if kind in ("headway", "distance"):
                direction, along, free = self._read_distance(one)
            else:
                direction = self._read_direction(one)
            return Condition(kind, rule, value, other=other, along=along, free=free, direction=direction)
        match one.tag:
            case "CollisionCondition":
                one_value = self.parameters.constant(1.0)
                return Condition("collision", "equalTo", one_value, against=self._read_against(one))
            case "RelativeClearanceCondition":
                return self._read_clearance(one)
            case "EndOfRoadCondition" | "OffroadCondition":
                kind = "road_end" if one.tag == "EndOfRoadCondition" else "off_road"
                steps = round(self.parameters.fixed(one, "duration") / self.dt)
                return Condition(kind, "equalTo", self.parameters.constant(1.0), delay=max(steps, 0))
            case "AngleCondition" | "RelativeAngleCondition":
                return self._read_angle(one)
            case "StandStillCondition":
                return Condition("standstill", "greaterOrEqual", self.parameters.number(one, "duration"))
            case "TimeToCollisionCondition":
                return self._read_collision_time(one)
            case "DistanceCondition":
                rule, value = self._read_comparison(one)
                side, along, free = self._read_distance(one)
                place = self._place(one)
                return Condition("distance", rule, value, along=along, free=free, place=place, direction=side)
            case "ReachPositionCondition":
                tolerance = self.parameters.number(one, "tolerance")
                return Condition("reach", "lessOrEqual", tolerance, along=False, place=self._place(one))
        known = ", ".join((*simple, "StandStillCondition", "TimeToCollisionCondition", "DistanceCondition"))
        raise one.unknown(f"{known}, ReachPositionCondition")

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
        rule, value = self._read_comparison(one)
        _, along, free = self._read_distance(one)
        if not along:
            raise one.error(
                "a time to collision is read along the road", 'relativeDistanceType="longitudinal"'
            )
        one.note("is taken along the road, also to vehicles in other lanes")
        target = one.child("TimeToCollisionConditionTarget").choice()
        if target.tag == "Position":
            place = self.actions.read_place(target)
            return Condition("collision_time", rule, value, free=free, place=place)
        if target.tag != "EntityRef":
            raise target.unknown("EntityRef, Position")
        other = self.actions.find_entity(target)
        return Condition("collision_time", rule, value, other=other, free=free)

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
        return Condition(
            "clearance",
            "equalTo",
            self.parameters.constant(1.0),
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
        target = one.choice()
        if target.tag == "EntityRef":
            return self.actions.find_members(target)
        if target.tag not in ("ByType", "ByObjectType"):
            raise target.unknown("EntityRef, ByType, ByObjectType")
        return self.actions.find_type(target)

    def _read_distance(self, one: Element) -> tuple[Direction, bool, bool]:
        # Direction of a distance, whether it is along the road, and whether between the boxes.
        along = self.parameters.boolean(one, "alongRoute") or one.tag == "TimeToCollisionCondition"
        default = "longitudinal" if along else "euclidianDistance"
        kind = self.parameters.choose(one, "relativeDistanceType", _DISTANCES, default)
        self.parameters.choose(one, "coordinateSystem", _SYSTEMS, "entity")
        one.get("routingAlgorithm")
        one.attribute("freespace")
        side: Direction = "lateral" if kind == "lateral" else ""
        return side, kind == "longitudinal", self.parameters.boolean(one, "freespace")
