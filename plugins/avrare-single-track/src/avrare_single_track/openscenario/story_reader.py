"""Reading of a storyboard: acts, events, actions and conditions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, get_args

from avrare_single_track.openscenario.catalogs import Catalogs
from avrare_single_track.openscenario.opendrive import RoadMap
from avrare_single_track.openscenario.parameters import Number, Parameters
from avrare_single_track.openscenario.place_reader import find_entity, find_lane, read_place
from avrare_single_track.openscenario.story import (
    DIMENSIONS,
    FORMS,
    Action,
    Condition,
    Edge,
    Event,
    LaneChange,
    Place,
    Rule,
    SpeedChange,
    Storyboard,
    Transition,
    Trigger,
)
from avrare_single_track.openscenario.xml_tree import Element

_LONGEST_DELAY = 10_000
"""Longest delay of a condition [steps]."""


@dataclass(frozen=True)
class _Named:
    # Element of the storyboard that a condition may refer to.
    kind: str
    path: tuple[str, ...]
    events: tuple[int, ...]
    begin: Literal["event", "act", "story"] = "event"
    act: int = -1
    alone: bool = True  # the only action of its event


class StoryReader:
    """Reader of one file's storyboard.

    Args:
        parameters: Its parameters.
        roads: Its road.
        names: Names of the entities, the ego last.
        dt: Step [s].
        ego: Index of the entity that a stack drives; None: all obey the storyboard.
        ignore_ego: Whether actions of the ego are passed over.
        catalogs: Catalogs of maneuvers.
    """

    def __init__(
        self,
        parameters: Parameters,
        roads: RoadMap,
        names: Sequence[str],
        dt: float,
        ego: int | None,
        ignore_ego: bool,
        catalogs: Catalogs,
    ) -> None:
        self.parameters, self.roads, self.names, self.dt = parameters, roads, names, dt
        self.ego, self.ignore_ego, self.catalogs = ego, ignore_ego, catalogs
        self.actions: list[Action] = []
        self.events: list[Event] = []
        self.conditions: list[Condition] = []
        self.acts: list[Trigger] = []
        self.maneuvers = 0
        self.elements: list[_Named] = []
        self._path: list[str] = []
        self._waiting: list[tuple[int, Element]] = []

    def read(self, board: Element, places: tuple[Place, ...], speeds: tuple[Number, ...]) -> Storyboard:
        """Read the element ``Storyboard``."""
        board.skip_children("StopTrigger")  # the scenario's ``steps`` end a rollout
        for story in board.list("Story"):
            with self._named(story, "story"):
                for act in story.list("Act"):
                    self._read_act(act)
        for index, element in self._waiting:
            self._resolve_state(index, element)
        return Storyboard(
            places, speeds, tuple(self.acts), tuple(self.events), tuple(self.actions), tuple(self.conditions)
        )

    @contextmanager
    def _named(self, element: Element, kind: str, act: int = -1) -> Iterator[None]:
        # What is read within belongs to the element.
        first = len(self.events)
        self._path.append(element.get("name") or "")
        yield
        events = tuple(range(first, len(self.events)))
        begin: Literal["event", "act", "story"] = "act" if act >= 0 else "event"
        begin = "story" if kind == "story" else begin
        self.elements.append(_Named(kind, tuple(self._path), events, begin, act))
        self._path.pop()

    def _read_act(self, act: Element) -> None:
        index = len(self.acts)
        start = act.find("StartTrigger")
        self.acts.append(() if start is None else self._read_trigger(start))
        stop = act.find("StopTrigger")
        if stop is not None and stop.children:
            raise stop.error("the end of an act is not read", "an act lasts as long as its events")
        with self._named(act, "act", index):
            for group in act.list("ManeuverGroup"):
                with self._named(group, "maneuverGroup", index):
                    self._read_group(group, index)

    def _read_group(self, group: Element, act: int) -> None:
        _check_count(group)
        actors = group.child("Actors")
        if _read_boolean(actors, "selectTriggeringEntities"):
            raise actors.error("selectTriggeringEntities is not read", "name the actors")
        chosen = [
            find_entity(one, "entityRef", self.parameters, self.names) for one in actors.list("EntityRef")
        ]
        referred = [self.catalogs.resolve(one, ("Maneuver",)) for one in group.list("CatalogReference")]
        for maneuver in [*referred, *group.list("Maneuver")]:
            with self._named(maneuver, "maneuver", act):
                self._read_maneuver(maneuver, act, chosen)

    def _read_maneuver(self, maneuver: Element, act: int, actors: list[int]) -> None:
        if self.ego in actors:
            if not self.ignore_ego:
                text = "the ego is driven by the controller under test, not by the storyboard"
                raise maneuver.error(text, "take it out, or set `ignore_ego_events: true`")
            actors = [actor for actor in actors if actor != self.ego]
        for event in maneuver.list("Event"):
            with self._named(event, "event"):
                self._read_event(event, act, actors)
        self.maneuvers += 1

    def _read_event(self, event: Element, act: int, actors: list[int]) -> None:
        _check_count(event)
        priority = event.get("priority") or "parallel"
        if priority not in ("override", "overwrite", "parallel"):
            raise event.error(f"the priority {priority!r} is not read", "override or parallel")
        first, number = len(self.actions), len(self.events)
        elements = event.list("Action")
        for element in elements:
            path = (*self._path, element.get("name") or "")
            self.elements.append(_Named("action", path, (number,), alone=len(elements) == 1))
            for actor in actors:
                self.actions.append(self._read_action(element, actor))
            if not actors:
                element.skip()
        start = event.find("StartTrigger")
        trigger = () if start is None else self._read_trigger(start)
        actions = tuple(range(first, len(self.actions)))
        name = event.attribute("name")
        self.events.append(Event(name, act, self.maneuvers, trigger, actions, priority != "parallel"))

    def _read_action(self, element: Element, actor: int) -> Action:
        kind = element.choice()
        if kind.tag != "PrivateAction":
            raise kind.unknown("PrivateAction")
        domain = kind.choice()
        if domain.tag not in ("LongitudinalAction", "LateralAction"):
            raise domain.unknown("SpeedAction in a LongitudinalAction, LaneChangeAction in a LateralAction")
        action = domain.choice()
        match action.tag:
            case "SpeedAction":
                return self._read_speed_change(action, actor)
            case "LaneChangeAction":
                return self._read_lane_change(action, actor)
            case "LaneOffsetAction":
                return self._read_lane_offset(action, actor)
        raise action.unknown("SpeedAction, LaneChangeAction, LaneOffsetAction")

    def _read_transition(self, element: Element) -> Transition:
        form = self.parameters.text(element, "dynamicsShape")
        dimension = self.parameters.text(element, "dynamicsDimension")
        for name, found, known in (
            ("dynamicsShape", form, FORMS),
            ("dynamicsDimension", dimension, DIMENSIONS),
        ):
            if found not in known:
                raise element.error(f"{name} should be one of {', '.join(known)}, found {found!r}")
        if element.get("followingMode") not in (None, "position"):
            raise element.error("followingMode should be position")
        value = self.parameters.number(element, "value", low=0.0)
        return Transition(form, dimension, value)  # type: ignore[arg-type]  # checked above

    def _read_speed_change(self, action: Element, actor: int) -> SpeedChange:
        transition = self._read_transition(action.child("SpeedActionDynamics"))
        target = action.child("SpeedActionTarget").choice()
        absolute = target.tag == "AbsoluteTargetSpeed"
        value = self.parameters.number(target, "value", low=0.0 if absolute else None)
        if absolute:
            return SpeedChange(actor, transition, value)
        if target.tag != "RelativeTargetSpeed":
            raise target.unknown("AbsoluteTargetSpeed, RelativeTargetSpeed")
        if _read_boolean(target, "continuous"):
            raise target.error("continuous is not read", "the speed of the other counts at the start")
        kind = self.parameters.text(target, "speedTargetValueType")
        if kind not in ("delta", "factor"):
            raise target.error(f"speedTargetValueType should be delta or factor, found {kind!r}")
        other = find_entity(target, "entityRef", self.parameters, self.names)
        return SpeedChange(actor, transition, value, other, kind == "factor")

    def _read_lane_change(self, action: Element, actor: int) -> LaneChange:
        transition = self._read_transition(action.child("LaneChangeActionDynamics"))
        offset = self.parameters.number(action, "targetLaneOffset", 0.0)
        target = action.child("LaneChangeTarget").choice()
        if target.tag == "AbsoluteTargetLane":
            lane = find_lane(target, "value", self.parameters, self.roads)
            return LaneChange(actor, transition, lane, offset)
        if target.tag != "RelativeTargetLane":
            raise target.unknown("AbsoluteTargetLane, RelativeTargetLane")
        other = find_entity(target, "entityRef", self.parameters, self.names)
        return LaneChange(actor, transition, self.parameters.whole(target, "value"), offset, other)

    def _read_lane_offset(self, action: Element, actor: int) -> LaneChange:
        if _read_boolean(action, "continuous"):
            raise action.error("continuous is not read", "an offset is kept until another action")
        dynamics = action.child("LaneOffsetActionDynamics")
        form = self.parameters.text(dynamics, "dynamicsShape")
        if form != "step":
            text = f"dynamicsShape {form!r} has no given length"
            raise dynamics.error(text, "use step, or a LaneChangeAction with targetLaneOffset")
        dynamics.get("maxLateralAcc")
        target = action.child("LaneOffsetTarget").choice()
        if target.tag != "AbsoluteTargetLaneOffset":
            raise target.unknown("AbsoluteTargetLaneOffset")
        none = Transition("step", "time", self.parameters.constant(0.0))
        offset = self.parameters.number(target, "value")
        return LaneChange(actor, none, 0, offset, actor)

    def _read_trigger(self, trigger: Element) -> Trigger:
        groups = []
        for group in trigger.list("ConditionGroup"):
            first = len(self.conditions)
            for condition in group.list("Condition"):
                self._read_condition(condition)
            if len(self.conditions) == first:
                raise group.error("has no condition")
            groups.append(tuple(range(first, len(self.conditions))))
        if not groups:
            raise trigger.error("has no condition, so it never starts", "take it out, or fill it")
        return tuple(groups)

    def _read_condition(self, condition: Element) -> None:
        condition.get("name")
        edge = condition.get("conditionEdge") or "none"
        if edge not in get_args(Edge):
            raise condition.error(f"conditionEdge should be one of {', '.join(get_args(Edge))}")
        seconds = condition.get("delay") or "0"
        try:
            delay = round(float(seconds) / self.dt)
        except (ValueError, OverflowError):
            delay = -1
        if not 0 <= delay <= _LONGEST_DELAY:
            raise condition.error(
                f"delay should be a time from 0 to {_LONGEST_DELAY} steps, found {seconds!r}"
            )
        kind = condition.choice()
        if kind.tag == "ByValueCondition":
            found = self._read_by_value(kind.choice())
        elif kind.tag == "ByEntityCondition":
            found = self._read_by_entity(kind)
        else:
            raise kind.unknown("ByValueCondition, ByEntityCondition")
        self.conditions.append(Condition(**{**vars(found), "edge": edge, "delay": delay}))

    def _read_by_value(self, one: Element) -> Condition:
        if one.tag == "SimulationTimeCondition":
            return Condition("time", *self._read_comparison(one))
        if one.tag == "StoryboardElementStateCondition":
            self._waiting.append((len(self.conditions), one))
            return Condition("state", "equalTo", self.parameters.constant(0.0))
        raise one.unknown("SimulationTimeCondition, StoryboardElementStateCondition")

    def _resolve_state(self, index: int, one: Element) -> None:
        kind, state = one.attribute("storyboardElementType"), one.attribute("state")
        name = one.attribute("storyboardElementRef")
        parts = tuple(re.split("::|/", name))
        known = ("standbyState", "runningState", "completeState", "startTransition", "endTransition")
        if state not in known:
            raise one.error(f"the state {state!r} is not read", f"known here: {', '.join(known)}")
        found = [each for each in self.elements if (each.kind, each.path[-len(parts) :]) == (kind, parts)]
        if not found:
            raise one.error(f"there is no {kind} {name!r}")
        if len(found) > 1:
            text = f"there are {len(found)} elements {kind} {name!r}"
            raise one.error(text, f"say which one: {'::'.join(found[0].path)}")
        if not found[0].alone and state not in ("standbyState", "startTransition"):
            raise one.error("the end of one action among several is not read", "ask for that of the event")
        asked = {"events": found[0].events, "state": state, "begin": found[0].begin, "act": found[0].act}
        self.conditions[index] = Condition(**{**vars(self.conditions[index]), **asked})

    def _read_comparison(self, one: Element, value: str = "value") -> tuple[Rule, Number]:
        rule = self.parameters.text(one, "rule")
        if rule not in get_args(Rule):
            raise one.error(f"rule should be one of {', '.join(get_args(Rule))}, found {rule!r}")
        return rule, self.parameters.number(one, value)  # type: ignore[return-value]  # checked above

    def _read_by_entity(self, condition: Element) -> Condition:
        triggering = condition.child("TriggeringEntities")
        entities = tuple(
            find_entity(one, "entityRef", self.parameters, self.names) for one in triggering.list("EntityRef")
        )
        amount = triggering.attribute("triggeringEntitiesRule")
        if amount not in ("any", "all") or not entities:
            raise triggering.error("should name entities, any or all of them")
        found = self._read_entity_condition(condition.child("EntityCondition").choice())
        return Condition(**{**vars(found), "entities": entities, "every": amount == "all"})

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
            if one.get("direction") is not None:
                raise one.error("direction is not read")
            other = -1
            if one.tag in ("RelativeSpeedCondition", "TimeHeadwayCondition", "RelativeDistanceCondition"):
                other = find_entity(one, "entityRef", self.parameters, self.names)
            along, free = (
                self._read_distance(one) if simple[one.tag] in ("headway", "distance") else (True, False)
            )
            return Condition(simple[one.tag], rule, value, other=other, along=along, free=free)
        match one.tag:
            case "StandStillCondition":
                return Condition("standstill", "greaterOrEqual", self.parameters.number(one, "duration"))
            case "TimeToCollisionCondition":
                return self._read_collision_time(one)
            case "DistanceCondition":
                rule, value = self._read_comparison(one)
                along, free = self._read_distance(one)
                return Condition("distance", rule, value, along=along, free=free, place=self._place(one))
            case "ReachPositionCondition":
                tolerance = self.parameters.number(one, "tolerance")
                return Condition("reach", "lessOrEqual", tolerance, along=False, place=self._place(one))
        known = ", ".join((*simple, "StandStillCondition", "TimeToCollisionCondition", "DistanceCondition"))
        raise one.unknown(f"{known}, ReachPositionCondition")

    def _read_collision_time(self, one: Element) -> Condition:
        rule, value = self._read_comparison(one)
        along, free = self._read_distance(one)
        if not along:
            raise one.error(
                "a time to collision is read along the road", 'relativeDistanceType="longitudinal"'
            )
        target = one.child("TimeToCollisionConditionTarget").choice()
        if target.tag != "EntityRef":
            raise target.unknown("EntityRef")
        other = find_entity(target, "entityRef", self.parameters, self.names)
        return Condition("collision_time", rule, value, other=other, free=free)

    def _place(self, one: Element) -> Place:
        place = read_place(one.child("Position"), self.parameters, self.roads, self.names)
        if place.other >= 0:
            raise one.error("a relative position is not read here", "give the place itself")
        return place

    def _read_distance(self, one: Element) -> tuple[bool, bool]:
        # Whether a distance is along the road, and whether between the boxes.
        kind = one.get("relativeDistanceType")
        if kind is None:
            along = _read_boolean(one, "alongRoute") or one.tag == "TimeToCollisionCondition"
            kind = "longitudinal" if along else "euclidianDistance"
        one.get("alongRoute")
        if kind not in ("longitudinal", "cartesianDistance", "euclidianDistance"):
            raise one.error(f"relativeDistanceType {kind!r} is not read")
        if one.get("coordinateSystem") not in (None, "entity", "lane", "road"):
            raise one.error("coordinateSystem should be entity, lane or road")
        one.get("routingAlgorithm")
        one.attribute("freespace")
        return kind == "longitudinal", _read_boolean(one, "freespace")


def _check_count(element: Element) -> None:
    element.get("name")
    if (element.get("maximumExecutionCount") or "1") != "1":
        raise element.error("maximumExecutionCount should be 1")


def _read_boolean(element: Element, name: str) -> bool:
    # False where it is not there.
    text = element.get(name) or "false"
    if text not in ("true", "false", "1", "0"):
        raise element.error(f"{name} should be true or false, found {text[:40]!r}")
    return text in ("true", "1")
