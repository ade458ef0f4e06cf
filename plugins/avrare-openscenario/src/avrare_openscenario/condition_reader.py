"""Reading of conditions."""

from __future__ import annotations

from dataclasses import replace

from avrare_openscenario.action_reader import ActionReader
from avrare_openscenario.parameters import Number
from avrare_openscenario.story import EDGES, RULES, Condition, Direction, Place, Rule
from avrare_openscenario.xml_tree import Element

_DIRECTIONS: tuple[Direction, ...] = ("longitudinal", "lateral")
_MEASURES = {
    "SpeedCondition": ("speed", _DIRECTIONS[:1]),
    "RelativeSpeedCondition": ("relative_speed", _DIRECTIONS),
    "AccelerationCondition": ("acceleration", _DIRECTIONS[:1]),
}
_SYSTEMS = ("entity", "lane", "road", "trajectory", "world")


class ConditionReader:
    """Reader of the conditions of one file."""

    def __init__(self, actions: ActionReader, dt: float) -> None:
        self.actions, self.parameters, self.dt = actions, actions.parameters, dt

    def read(self, condition: Element) -> Condition:
        """Read a ``Condition``."""
        condition.get("name")
        edge = self.parameters.choose(condition, "conditionEdge", EDGES, "none")
        delay = 0 if condition.get("delay") is None else self._read_steps(condition, "delay")
        kind = condition.choice("ByValueCondition", "ByEntityCondition")
        if kind.tag == "ByValueCondition":
            result = self._read_by_value(kind.choice())
        else:
            result = self._read_by_entity(kind)
        return replace(result, edge=edge, delay=result.delay + delay)

    def _read_by_value(self, element: Element) -> Condition:
        match element.tag:
            case "SimulationTimeCondition":
                return Condition("time", *self._read_comparison(element))
            case "StoryboardElementStateCondition":  # resolved when all elements are read
                return Condition("state", "equalTo", self.parameters.constant(0.0))
            case "ParameterCondition" | "VariableCondition":
                variable = self.actions.find_variable(element)
                rule = self.parameters.choose(element, "rule", RULES)
                value = self.parameters.value(element, "value")
                return Condition("variable", rule, value, variable=variable)
            case "TrafficSignalCondition" | "TrafficSignalControllerCondition":
                return self.actions.lights.read_condition(element)
            case "UserDefinedValueCondition":
                element.pass_over("is never met: nothing outside the file sets values")
                return Condition("time", "lessThan", self.parameters.constant(-1.0))
        raise element.error("is not read", "see docs/openscenario.md")

    def _read_comparison(self, element: Element) -> tuple[Rule, Number]:
        return self.parameters.choose(element, "rule", RULES), self.parameters.number(element, "value")

    def _read_by_entity(self, condition: Element) -> Condition:
        triggering = condition.child("TriggeringEntities")
        entities = self.actions.find_entities(triggering)
        amount = self.parameters.choose(triggering, "triggeringEntitiesRule", ("any", "all"))
        if not entities:
            raise triggering.error("names no entities")
        measure = self._read_entity_condition(condition.child("EntityCondition").choice())
        return replace(measure, entities=entities, every=amount == "all")

    def _read_entity_condition(self, element: Element) -> Condition:
        match element.tag:
            case "SpeedCondition" | "RelativeSpeedCondition" | "AccelerationCondition":
                rule, value = self._read_comparison(element)
                kind, directions = _MEASURES[element.tag]
                direction = self.parameters.choose(element, "direction", directions, "")
                other = self.actions.find_entity(element) if kind == "relative_speed" else -1
                return Condition(kind, rule, value, other=other, direction=direction)
            case "TraveledDistanceCondition":
                return Condition("travelled", "greaterOrEqual", self.parameters.number(element, "value"))
            case "StandStillCondition":
                return Condition("standstill", "greaterOrEqual", self.parameters.number(element, "duration"))
            case "TimeHeadwayCondition" | "RelativeDistanceCondition":
                kind = "headway" if element.tag == "TimeHeadwayCondition" else "distance"
                return replace(self._read_distance(element, kind), other=self.actions.find_entity(element))
            case "DistanceCondition":
                return replace(self._read_distance(element, "distance"), place=self._place(element))
            case "TimeToCollisionCondition":
                return self._read_collision_time(element)
            case "ReachPositionCondition":
                tolerance = self.parameters.number(element, "tolerance")
                return Condition("reach", "lessOrEqual", tolerance, along=False, place=self._place(element))
            case "CollisionCondition":
                return replace(self._ask("collision"), against=self._read_against(element))
            case "RelativeClearanceCondition":
                return self._read_clearance(element)
            case "EndOfRoadCondition" | "OffroadCondition":
                kind = "road_end" if element.tag == "EndOfRoadCondition" else "off_road"
                return replace(self._ask(kind), delay=self._read_steps(element, "duration"))
            case "AngleCondition" | "RelativeAngleCondition":
                return self._read_angle(element)
        raise element.error("is not read", "see docs/openscenario.md")

    def _ask(self, kind: str) -> Condition:
        # Condition that holds where what is measured is 1.
        return Condition(kind, "equalTo", self.parameters.constant(1.0))

    def _read_angle(self, element: Element) -> Condition:
        # Whether a heading is within a tolerance of an angle.
        self.parameters.choose(element, "angleType", ("heading",))  # roads are flat
        relative = element.tag == "RelativeAngleCondition"
        frames = ("entity", "lane") if relative else ("world", "road", "lane")
        frame = self.parameters.choose(element, "coordinateSystem", frames, frames[0])
        other = self.actions.find_entity(element) if relative else -1
        angle, limit = (self.parameters.number(element, name) for name in ("angle", "angleTolerance"))
        along = frame in ("road", "lane")
        return Condition("angle", "lessOrEqual", limit, other=other, along=along, reach=(angle,))

    def _read_collision_time(self, element: Element) -> Condition:
        distance = self._read_distance(element, "collision_time")
        if not distance.along:
            raise element.error(
                "a time to collision is read along the road", 'relativeDistanceType="longitudinal"'
            )
        element.note("is taken along the road, also to vehicles in other lanes")
        target = element.child("TimeToCollisionConditionTarget").choice("EntityRef", "Position")
        if target.tag == "Position":
            return replace(distance, place=self.actions.read_place(target))
        return replace(distance, other=self.actions.find_entity(target))

    def _read_clearance(self, element: Element) -> Condition:
        # Whether no other vehicle is within a way ahead and behind, in some lanes.
        reach = tuple(
            self.parameters.number(element, name, 0.0) for name in ("distanceForward", "distanceBackward")
        )
        if self.parameters.boolean(element, "oppositeLanes"):
            element.note("vehicles in opposing lanes count where the lanes do")
        lanes = []
        many_lanes = 1_000
        for span in element.list("RelativeLaneRange"):
            low, high = (
                limit if span.get(name) is None else self.parameters.read_integer(span, name)
                for name, limit in (("from", -many_lanes), ("to", many_lanes))
            )
            lanes.append((low, high))
        return replace(
            self._ask("clearance"),
            free=self.parameters.boolean(element, "freeSpace"),
            against=self.actions.find_entities(element) or tuple(range(len(self.actions.kinds))),
            reach=reach,
            lanes=tuple(lanes),
        )

    def _place(self, element: Element) -> Place:
        return self.actions.read_place(element.child("Position"))

    def _read_against(self, element: Element) -> tuple[int, ...]:
        # Entities that a collision is with.
        target = element.choice("EntityRef", "ByType", "ByObjectType")
        if target.tag == "EntityRef":
            return self.actions.find_members(target)
        return self.actions.find_type(target)

    def _read_distance(self, element: Element, kind: str) -> Condition:
        # Condition on a distance, without what it is to.
        rule, value = self._read_comparison(element)
        along = self.parameters.boolean(element, "alongRoute") or kind == "collision_time"
        default = "longitudinal" if along else "euclidianDistance"
        kinds = ("longitudinal", "lateral", "cartesianDistance", "euclidianDistance")
        way = self.parameters.choose(element, "relativeDistanceType", kinds, default)
        self.parameters.choose(element, "coordinateSystem", _SYSTEMS, "entity")
        element.get("routingAlgorithm")
        element.attribute("freespace")
        free = self.parameters.boolean(element, "freespace")
        side: Direction = "lateral" if way == "lateral" else ""
        return Condition(kind, rule, value, along=way == "longitudinal", free=free, direction=side)

    def _read_steps(self, element: Element, name: str) -> int:
        # A time, as a number of steps.
        seconds = self.parameters.read_number(element, name)
        most_steps = 100_000  # longest delay of a condition [steps]
        if not 0.0 <= seconds <= most_steps * self.dt:
            text = f"{name} should be a time from 0 to {most_steps} steps, found {seconds:g}"
            raise element.error(text)
        return round(seconds / self.dt)
