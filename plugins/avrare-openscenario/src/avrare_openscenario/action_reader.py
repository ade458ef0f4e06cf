"""Reading of actions: what a vehicle does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from avrare.base.errors import did_you_mean
from avrare_openscenario import story
from avrare_openscenario.catalogs import Catalogs
from avrare_openscenario.curves import sample_clothoids, sample_nurbs
from avrare_openscenario.network import Network
from avrare_openscenario.parameters import Number, Parameters
from avrare_openscenario.place_reader import find_lane, read_place, read_route
from avrare_openscenario.signals import Signals
from avrare_openscenario.xml_tree import Element

_IDLE = {
    "ControllerAction": "controllers are left out: the entity obeys the storyboard",
    "ActivateControllerAction": "controllers are left out: the entity obeys the storyboard",
    "VisibilityAction": "visibility changes nothing",
    "AppearanceAction": "lights and animations change nothing",
    "EnvironmentAction": "environment and weather change nothing",
    "TrailerAction": "trailers are left out",
    "SetMonitorAction": "monitors change nothing",
}
"""Actions that are passed over, with their notes."""
_GLOBAL = ("EntityAction", "InfrastructureAction", "ParameterAction", "VariableAction")
_TYPES = {"vehicle": "Vehicle", "pedestrian": "Pedestrian", "miscellaneous": "MiscObject"}
_ENDLESS = 1e9
"""Limit that is not given."""


class ActionReader:
    """Reader of the actions of one file."""

    def __init__(
        self,
        parameters: Parameters,
        roads: Network,
        names: Sequence[str],
        kinds: Sequence[str],
        catalogs: Catalogs,
        lights: Signals,
    ) -> None:
        self.parameters, self.roads, self.names, self.kinds = parameters, roads, names, kinds
        self.catalogs, self.lights, self.variables = catalogs, lights, lights.variables
        self.selections: dict[str, tuple[int, ...]] = {}

    def read_selections(self, entities: Element) -> None:
        """Read each ``EntitySelection``; from here on its name refers to its members."""
        for selection in entities.list("EntitySelection"):
            members = selection.child("Members")
            types = [self.find_type(entry, "objectType") for entry in members.list("ByType")]
            indices = sum(types, self.find_entities(members))
            self.selections[self.parameters.text(selection, "name")] = tuple(dict.fromkeys(indices))

    def read_global(self, kind: Element) -> story.Action | None:
        """Read a ``GlobalAction`` or ``UserDefinedAction``; None: it changes nothing."""
        if kind.tag == "UserDefinedAction":
            raise kind.error("a user-defined action is not read", "take it out")
        action = kind.choice(*_GLOBAL, *_IDLE)
        if action.tag in _IDLE:
            action.pass_over(_IDLE[action.tag])
            return None
        if action.tag == "InfrastructureAction":
            return self.lights.read_action(action.child("TrafficSignalAction"))
        if action.tag != "EntityAction":
            return self._read_assignment(action)
        actor, change = self.find_entity(action), action.choice("AddEntityAction", "DeleteEntityAction")
        if change.tag == "AddEntityAction":
            return self._read_teleport(change, actor)
        return story.Removal(actor)

    def read_private(self, private: Element, actor: int) -> story.Action | None:
        """Read a ``PrivateAction`` of a vehicle; None: it changes nothing."""
        domains = ("LongitudinalAction", "LateralAction", "RoutingAction")
        action = private.choice(*domains, "TeleportAction", "SynchronizeAction", *_IDLE)
        if action.tag in _IDLE:
            action.pass_over(_IDLE[action.tag])
            return None
        readers: dict[str, Callable[[Element, int], story.Action]] = {
            "TeleportAction": self._read_teleport,
            "SynchronizeAction": self._read_synchronize,
            "SpeedAction": self._read_speed_change,
            "SpeedProfileAction": self._read_profile,
            "LongitudinalDistanceAction": self._read_gap,
            "LateralDistanceAction": self._read_gap,
            "LaneChangeAction": self._read_lane_change,
            "LaneOffsetAction": self._read_lane_offset,
            "AssignRouteAction": partial(read_route, self),
            "AcquirePositionAction": partial(read_route, self),
            "FollowTrajectoryAction": self._read_trajectory,
        }
        if action.tag in domains:
            action = action.choice(*readers)
        return readers[action.tag](action, actor)

    def _number(self, element: Element, name: str, default: float | None = None) -> Number:
        return self.parameters.number(element, name, default)

    def _limit(self, element: Element | None, name: str) -> Number | None:
        if element is None or element.get(name) is None:
            return None
        return self.parameters.number(element, name, low=0.0)

    def _read_teleport(self, action: Element, actor: int) -> story.Teleport:
        return story.Teleport(actor, self.read_place(action.child("Position")))

    def read_place(self, position: Element) -> story.Place:
        """Read a ``Position``."""
        return read_place(self, position)

    def find_entity(self, element: Element, name: str = "entityRef") -> int:
        """Return the index of the entity that an attribute names."""
        text = self.parameters.text(element, name)
        if text not in self.names:
            raise element.error(f"there is no entity {text!r}", did_you_mean(text, self.names))
        return list(self.names).index(text)

    def find_entities(self, element: Element) -> tuple[int, ...]:
        """Return the indices of the entities that the elements ``EntityRef`` name."""
        return sum(map(self.find_members, element.list("EntityRef")), tuple[int, ...]())

    def find_members(self, element: Element) -> tuple[int, ...]:
        """Return the indices of the members of a selection, or of the entity, that an element names."""
        members = self.selections.get(self.parameters.text(element, "entityRef"))
        return (self.find_entity(element),) if members is None else members

    def find_type(self, element: Element, name: str = "type") -> tuple[int, ...]:
        """Return the indices of the entities of the type that an attribute has."""
        kind = _TYPES[self.parameters.choose(element, name, tuple(_TYPES))]
        return tuple(index for index, other in enumerate(self.kinds) if other == kind)

    def find_variable(self, element: Element) -> int:
        """Return the index of the variable or parameter that an element names."""
        kind = "variableRef" if element.get("variableRef") is not None else "parameterRef"
        name = self.parameters.text(element, kind)
        if name not in self.variables:
            raise element.error(f"there is no variable {name!r}", did_you_mean(name, self.variables))
        return list(self.variables).index(name)

    def _read_assignment(self, action: Element) -> story.Assignment:
        name = self.find_variable(action)
        change = action.choice("SetAction", "ModifyAction")
        if change.tag == "SetAction":
            return story.Assignment(name, self.parameters.value(change, "value"), "set")
        rule = change.child("Rule").choice("AddValue", "MultiplyByValue")
        operation: Literal["add", "multiply"] = "add" if rule.tag == "AddValue" else "multiply"
        return story.Assignment(name, self._number(rule, "value"), operation)

    def _read_transition(self, element: Element) -> story.Transition:
        form = self.parameters.choose(element, "dynamicsShape", story.FORMS)
        dimension = self.parameters.choose(element, "dynamicsDimension", story.DIMENSIONS)
        self._read_following(element)
        low = 0.0 if dimension != "rate" else None  # of a rate, the size counts
        value = self.parameters.number(element, "value", 0.0 if form == "step" else None, low)
        return story.Transition(form, dimension, value)

    def _read_following(self, element: Element) -> None:
        # A note where a file asks for limits of the vehicle, which are left out.
        mode = self.parameters.choose(element, "followingMode", ("position", "follow"), "position")
        if mode == "follow":
            element.note("followed exactly: limits of the vehicle are left out")

    def _read_speed_change(self, action: Element, actor: int) -> story.SpeedChange:
        transition = self._read_transition(action.child("SpeedActionDynamics"))
        target = action.child("SpeedActionTarget").choice("AbsoluteTargetSpeed", "RelativeTargetSpeed")
        continuous = target.tag == "RelativeTargetSpeed" and self.parameters.boolean(target, "continuous")
        return story.SpeedChange(actor, transition, self._read_speed(target, target, "entityRef"), continuous)

    def _read_speed(self, target: Element, holder: Element, name: str) -> story.TargetSpeed:
        # An absolute speed, or one relative to the vehicle that an attribute of the holder names.
        value = self._number(target, "value")
        if target.tag.startswith("Absolute"):
            return story.TargetSpeed(value)
        kind = self.parameters.choose(target, "speedTargetValueType", ("delta", "factor"))
        return story.TargetSpeed(value, self.find_entity(holder, name), kind == "factor")

    def _read_profile(self, action: Element, actor: int) -> story.SpeedProfile:
        modes = ("position", "follow")
        follows = self.parameters.choose(action, "followingMode", modes, "position") == "follow"
        limits = action.find("DynamicConstraints")
        entries, endless = action.list("SpeedProfileEntry"), self.parameters.constant(_ENDLESS)
        if action.get("entityRef") is not None:
            raise action.error("speeds relative to another entity are not read")
        if follows and entries and entries[0].attributes.get("time") in ("0", "0.0"):
            entries[0].skip()  # it begins with the own speed
            entries = entries[1:]
        if not entries:
            raise action.error("has no SpeedProfileEntry")
        names = [f"max{kind}{rate}" for rate in ("", "Rate") for kind in ("Acceleration", "Deceleration")]
        values = [self._limit(limits, name) for name in names]
        most = [endless if limit is None else limit for limit in values]
        most = most if follows else [*most[:2], endless, endless]
        if limits is not None:
            limits.get("maxSpeed")
        elif any(entry.get("time") is None for entry in entries):
            raise entries[0].error("has no time", "give it one, or the action DynamicConstraints")
        durations = tuple(self.parameters.number(entry, "time", 0.0, low=0.0) for entry in entries)
        speeds = tuple(self._number(entry, "speed") for entry in entries)
        return story.SpeedProfile(actor, durations, speeds, tuple(most))

    def _read_gap(self, action: Element, actor: int) -> story.Gap:
        across = action.tag == "LateralDistanceAction"
        timed = action.get("timeGap") is not None
        value = self._number(action, "timeGap" if timed else "distance", 0.0)
        sides = {"leadingReferencedEntity": 1, "trailingReferencedEntity": -1, "any": 0}
        sides |= {"leftToReferencedEntity": 1, "rightToReferencedEntity": -1}
        side = self.parameters.choose(action, "displacement", tuple(sides), "any")
        frame = action.get("coordinateSystem") or "entity"
        if (limits := action.find("DynamicConstraints")) is not None:
            limits.skip()  # deceleration and jerk are not limited
        return story.Gap(
            actor,
            self.find_entity(action),
            value,
            timed,
            self.parameters.boolean(action, "freespace"),
            sides[side],
            across,
            self.parameters.boolean(action, "continuous"),
            self._limit(limits, "maxAcceleration"),
            self._limit(limits, "maxSpeed"),
            across and frame == "entity",
        )

    def _read_lane_change(self, action: Element, actor: int) -> story.LaneChange:
        transition = self._read_transition(action.child("LaneChangeActionDynamics"))
        offset = self._number(action, "targetLaneOffset", 0.0)
        target = action.child("LaneChangeTarget").choice("AbsoluteTargetLane", "RelativeTargetLane")
        if target.tag == "AbsoluteTargetLane":
            return story.LaneChange(actor, transition, find_lane(self, target, "value"), offset)
        other = self.find_entity(target)
        return story.LaneChange(
            actor, transition, self.parameters.read_integer(target, "value"), offset, other
        )

    def _read_lane_offset(self, action: Element, actor: int) -> story.LaneChange:
        self.parameters.boolean(action, "continuous")  # an offset is kept until another action in any case
        dynamics = action.child("LaneOffsetActionDynamics")
        form = self.parameters.choose(dynamics, "dynamicsShape", story.FORMS)
        highest = self._limit(dynamics, "maxLateralAcc")
        transition = story.Transition("step", "time", self.parameters.constant(0.0))
        if form != "step" and highest is not None:
            transition = story.Transition(form, "curvature", highest)
        names = "AbsoluteTargetLaneOffset", "RelativeTargetLaneOffset"
        target = action.child("LaneOffsetTarget").choice(*names)
        offset = self._number(target, "value")
        if target.tag == "AbsoluteTargetLaneOffset":
            return story.LaneChange(actor, transition, 0, offset, actor)
        return story.LaneChange(actor, transition, 0, offset, self.find_entity(target), exact=True)

    def _read_trajectory(self, action: Element, actor: int) -> story.Trajectory:
        if mode := action.find("TrajectoryFollowingMode"):
            self._read_following(mode)
        reference = action.find("TimeReference")
        timing = None if reference is None else reference.find("Timing")
        absolute, scale, offset = False, 1.0, 0.0
        if timing is not None:
            domain = self.parameters.choose(timing, "domainAbsoluteRelative", ("absolute", "relative"))
            absolute = domain == "absolute"
            scale, offset = (self.parameters.read_number(timing, name) for name in ("scale", "offset"))
        holder = action.find("TrajectoryRef") or action
        curve = self.read_curve(holder, actor, timing is not None, scale, offset)
        begin = self._limit(action, "initialDistanceOffset")
        return replace(curve, begin=begin, absolute=absolute)

    def read_curve(
        self, holder: Element, actor: int, timed: bool, scale: float = 1.0, offset: float = 0.0
    ) -> story.Trajectory:
        """Read the trajectory in an element, or in the catalog that it refers to."""
        trajectory = self.catalogs.find(holder, "Trajectory")
        trajectory.get("name")
        trajectory.skip_children("ParameterDeclarations")
        if self.parameters.boolean(trajectory, "closed"):
            trajectory.note("a closed trajectory is driven once")
        form = trajectory.child("Shape").choice("Polyline", "Clothoid", "ClothoidSpline", "Nurbs")
        if form.tag == "Polyline":
            return self._read_polyline(form, actor, timed, scale, offset)
        if form.tag == "Nurbs":
            return self._read_nurbs(form, actor)
        names = ("startTime", "stopTime")
        if not timed or not all(form.get(name) for name in names):
            return self._read_clothoids(form, actor)
        times = tuple(self.parameters.scale(self._number(form, name), scale, offset) for name in names)
        return replace(self._read_clothoids(form, actor), times=times)

    def _read_polyline(
        self, form: Element, actor: int, timed: bool, scale: float, offset: float
    ) -> story.Trajectory:
        vertices = form.list("Vertex")
        if len(vertices) < 2:
            raise form.error("should have at least two vertices")
        places = tuple(self.read_place(vertex.child("Position")) for vertex in vertices)
        written = [vertex.get("time") for vertex in vertices]
        timed = timed and None not in written
        times = [self._number(vertex, "time") for vertex in vertices] if timed else []
        return story.Trajectory(
            actor, places, tuple(self.parameters.scale(time, scale, offset) for time in times)
        )

    def _read_clothoids(self, form: Element, actor: int) -> story.Trajectory:
        read_number = self.parameters.read_number
        pieces: list[tuple[float, float, float]] = []
        if form.tag == "Clothoid":
            start: Element | None = form.child("Position")
            length = read_number(form, "length")
            form.ignore("startTime", "stopTime")
            bend = read_number(form, "curvature")
            turn = "curvaturePrime" if form.get("curvaturePrime") is not None else "curvatureDot"
            pieces.append((length, bend, bend + length * read_number(form, turn)))
        else:
            form.get("timeEnd")
            segments = form.list("ClothoidSplineSegment")
            if not segments:
                raise form.error("has no ClothoidSplineSegment")
            start = segments[0].find("PositionStart")
            if start is None and actor < 0:
                raise form.error("its first segment has no PositionStart")
            for segment in segments:
                segment.get("timeStart")
                if segment is not segments[0] and segment.find("PositionStart") is not None:
                    raise segment.error("a later segment with a start of its own is not read")
                bends = read_number(segment, "curvatureStart"), read_number(segment, "curvatureEnd")
                pieces.append((read_number(segment, "length"), *bends))
        if any(length <= 0.0 for length, _, _ in pieces):
            raise form.error("a length should be above 0")
        shape = sample_clothoids(pieces)
        if start is not None:
            return story.Trajectory(actor, (self.read_place(start),), shape=shape)
        nothing = self.parameters.constant(0.0)  # it begins where the vehicle is
        return story.Trajectory(
            actor, (story.Place("ahead", nothing, nothing, nothing, other=actor),), shape=shape
        )

    def _read_nurbs(self, form: Element, actor: int) -> story.Trajectory:
        points = form.list("ControlPoint")
        places = tuple(self.read_place(point.child("Position")) for point in points)
        weights = []
        for point in points:
            point.get("time")
            weights.append(
                1.0 if point.get("weight") is None else self.parameters.read_number(point, "weight")
            )
        knots = [self.parameters.read_number(knot, "value") for knot in form.list("Knot")]
        order = self.parameters.read_integer(form, "order")
        if not 2 <= order <= len(points) or len(knots) != len(points) + order or np.any(np.diff(knots) < 0):
            raise form.error("should have at least `order` points, and as many ascending knots as both")
        return story.Trajectory(actor, places, shares=sample_nurbs(order, weights, knots))

    def _read_synchronize(self, action: Element, actor: int) -> story.Synchronize:
        final = action.find("FinalSpeed")
        speed, steady, steady_timed = None, None, False
        if final is not None:
            kind = final.choice("AbsoluteSpeed", "RelativeSpeedToMaster")
            speed = self._read_speed(kind, action, "masterEntityRef")
            for tag, timed in (("TargetDistanceSteadyState", False), ("TargetTimeSteadyState", True)):
                if (element := kind.find(tag)) is not None:
                    name = next(iter(element.attributes), "distance")
                    steady, steady_timed = self._number(element, name), timed
        return story.Synchronize(
            actor,
            self.find_entity(action, "masterEntityRef"),
            self.read_place(action.child("TargetPosition")),
            self.read_place(action.child("TargetPositionMaster")),
            speed,
            steady,
            steady_timed,
            self._number(action, "targetTolerance", 0.0),
            self._number(action, "targetToleranceMaster", 0.0),
        )
