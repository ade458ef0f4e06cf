"""Values of a storyboard: what vehicles do, and when. Numbers are columns of the parameters' table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from avrare_openscenario.network import RoadMap
from avrare_openscenario.parameters import Number

Form: TypeAlias = Literal["step", "linear", "cubic", "sinusoidal"]
FORMS: tuple[Form, ...] = get_args(Form)
"""Shapes of a transition."""
Dimension: TypeAlias = Literal["time", "distance", "rate", "curvature"]
DIMENSIONS: tuple[Dimension, ...] = ("time", "distance", "rate")
"""What the length of a transition is given in; a rate is the highest one.

``curvature`` stands for the highest second derivative, which an action gives by an acceleration.
"""
Rule: TypeAlias = Literal["lessThan", "lessOrEqual", "greaterThan", "greaterOrEqual", "equalTo", "notEqualTo"]
RULES: tuple[Rule, ...] = get_args(Rule)
Edge: TypeAlias = Literal["none", "rising", "falling", "risingOrFalling"]
EDGES: tuple[Edge, ...] = get_args(Edge)
Direction: TypeAlias = Literal["", "longitudinal", "lateral"]


@dataclass(frozen=True)
class Transition:
    """Way from an old value to a new one."""

    form: Form
    dimension: Dimension
    value: Number


@dataclass(frozen=True)
class Place:
    """Start of a vehicle: its own numbers, or relative to another vehicle.

    Attributes:
        kind: ``road``: x and y are station and offset; ``plane``: those of the file's plane; ``lane``: a
            station and the offset from a lane's centre; ``beside``: differences to another vehicle's
            station and to a lane beside its own, or to its offset where there is no lane; ``ahead``:
            differences along and across its body; ``shifted``: differences in the file's plane; ``curve``:
            way along a trajectory and offset from it.
        x: See above [m].
        y: The same [m].
        heading: Against the lane, or in the plane where ``absolute`` [rad].
        lane: Index of the lane of a ``lane``, or number of lanes to the left of the other's, of a ``beside``.
        other: Index of the other vehicle.
        absolute: Whether the heading is that in the plane.
        curve: Trajectory of a ``curve``.
        turned: Whether a heading is given.
        by_lane: Whether x of a ``beside`` goes in the direction of the lane, not of the road.
        roads: Road of a ``road`` or ``lane``; None: the one of the vehicle that is placed.
    """

    kind: Literal["road", "plane", "lane", "beside", "ahead", "shifted", "curve"]
    x: Number
    y: Number
    heading: Number
    lane: int | None = None
    other: int = -1
    absolute: bool = False
    curve: Trajectory | None = None
    turned: bool = False
    by_lane: bool = False
    roads: RoadMap | None = None


@dataclass(frozen=True)
class TargetSpeed:
    """Speed, by itself or from that of another vehicle.

    Attributes:
        value: Speed, or what is added to the other's, or the factor on it [m/s].
        other: Index of the other vehicle, -1: none.
        factor: Whether the value is a factor.
    """

    value: Number
    other: int = -1
    factor: bool = False


@dataclass(frozen=True)
class VehicleAction:
    """Action of a vehicle, whose index is ``actor``."""

    actor: int


@dataclass(frozen=True)
class SpeedChange(VehicleAction):
    """Action: a vehicle takes another speed.

    Attributes:
        transition: How.
        target: The speed.
        continuous: Whether it goes on to keep the speed that another vehicle's calls for.
    """

    transition: Transition
    target: TargetSpeed
    continuous: bool = False


@dataclass(frozen=True)
class SpeedProfile(VehicleAction):
    """Action: a vehicle takes speeds one after another, each linearly.

    Attributes:
        durations: Least time for each [s].
        speeds: The speeds [m/s].
        limits: Highest acceleration and deceleration [m/s^2], and highest rates of both [m/s^3].
    """

    durations: tuple[Number, ...]
    speeds: tuple[Number, ...]
    limits: tuple[Number, ...]


@dataclass(frozen=True)
class LaneChange(VehicleAction):
    """Action: a vehicle takes another place across the road.

    Attributes:
        transition: How.
        lane: Id of the lane, or number of lanes to the left of the other's.
        offset: Offset from the lane's centre [m].
        other: Index of the vehicle whose lane counts, -1: ``lane`` is the id.
        exact: Whether the offset is from the other's own place across, not from its lane's centre.
    """

    transition: Transition
    lane: int
    offset: Number
    other: int = -1
    exact: bool = False

    @property
    def reference(self) -> int:
        """Return the index of the vehicle whose lane or place counts: the named one, or itself."""
        return self.other if self.other >= 0 else self.actor


@dataclass(frozen=True)
class Gap(VehicleAction):
    """Action: a vehicle keeps a distance to another one.

    Attributes:
        other: Index of the other.
        value: The distance [m], or the time at the other's speed that it takes [s].
        timed: Whether it is a time.
        free: Whether it is between the boxes.
        side: 1 ahead or to the left of the other, -1 behind or to the right, 0 where it is at the start.
        across: Whether it is across the road.
        continuous: Whether it is kept until another action, or reached once.
        acceleration: Highest acceleration; None: it is reached at once [m/s2].
        speed: Highest speed; None: any [m/s].
        by_body: Whether "across" is so to the other's body, not to the road.
    """

    other: int
    value: Number
    timed: bool
    free: bool
    side: int
    across: bool
    continuous: bool
    acceleration: Number | None = None
    speed: Number | None = None
    by_body: bool = False


@dataclass(frozen=True)
class Trajectory(VehicleAction):
    """Action: a vehicle follows a line in the plane.

    Attributes:
        vertices: Points of the line.
        times: Time of each, empty: the vehicle keeps its own speed [s].
        shape: (M, 3) points x, y and heading from the first vertex on; None: a polyline of the vertices.
        shares: (M, P) shares of the P vertices in each of M points; None: points are the vertices.
        begin: Way along the line at which it begins [m].
        absolute: Whether times are those of the simulation, or count from the start of the action.
    """

    vertices: tuple[Place, ...]
    times: tuple[Number, ...] = ()
    shape: tuple[tuple[float, float, float], ...] | None = None
    shares: tuple[tuple[float, ...], ...] | None = None
    begin: Number | None = None
    absolute: bool = False

    @property
    def may_reverse(self) -> bool:
        """Return whether vehicles whose speed is below 0 drive along the line, against their own heading."""
        headed = self.shape is None and self.shares is None and all(place.turned for place in self.vertices)
        return self.begin is None and not self.times and not headed


@dataclass(frozen=True)
class Teleport(VehicleAction):
    """Action: a vehicle is put to another place."""

    place: Place


@dataclass(frozen=True)
class Removal(VehicleAction):
    """Action: a vehicle is taken out of the scene: it stands far away."""


@dataclass(frozen=True)
class Synchronize(VehicleAction):
    """Action: a vehicle reaches its target when another one reaches its own.

    Attributes:
        master: Index of the other.
        target: Where the vehicle is to be.
        master_target: Where the other is then.
        final: Speed there; None: any.
        steady: Way or time before the target on which that speed is held; None: none.
        steady_timed: Whether ``steady`` is a time.
        tolerance: Distance to the target that counts as reached [m].
        master_tolerance: The same of the other [m].
    """

    master: int
    target: Place
    master_target: Place
    final: TargetSpeed | None
    steady: Number | None
    steady_timed: bool
    tolerance: Number
    master_tolerance: Number


@dataclass(frozen=True)
class Assignment:
    """Action: a variable or parameter of the file takes another value.

    Attributes:
        name: Index of the variable.
        value: What it is set to, or is added, or the factor.
        operation: Which of these; ``start``: what it is now, from which on it grows with the time.
    """

    name: int
    value: Number
    operation: Literal["set", "add", "multiply", "start"]


@dataclass(frozen=True)
class Route(VehicleAction):
    """Action: a vehicle is to drive over some roads; only where no stack drives."""

    roads: tuple[RoadMap, ...]


Action: TypeAlias = VehicleAction | Assignment


@dataclass(frozen=True)
class Condition:
    """Condition of a trigger.

    Attributes:
        kind: ``time``, ``travelled``, ``speed``, ``relative_speed``, ``standstill``, ``distance``,
            ``headway``, ``collision_time``, ``reach``, ``acceleration``, ``collision``, ``road_end``,
            ``off_road``, ``clearance``, ``angle``, ``variable``, ``light`` or ``state``.
        rule: Comparison with ``value``.
        value: What is compared with.
        edge: Change of the comparison that counts.
        delay: Steps after which it counts.
        entities: Vehicles that it is asked of.
        every: Whether all of them must meet it, or any.
        other: Vehicle that it is about besides, or variable with the clock of a ``light``.
        along: Whether a distance, or an angle, is one along the road; else in the plane.
        free: Whether it is between the boxes.
        place: Place that is to be reached, or that a distance is to.
        events: Events that a ``state`` is about.
        state: The state.
        begin: What its begin is: that of an event, of an act, or of the simulation.
        act: Index of that act.
        direction: Part of a speed or acceleration that counts; empty: its size.
        variable: Index of the variable that is compared.
        against: Vehicles that a ``collision`` is with, or that a ``clearance`` is from.
        reach: Ways ahead and behind of a ``clearance`` [m]; the ``angle`` that is asked for [rad]; the cycle
            of a ``light``, and the begin and end of each of its phases [s].
        lanes: Ranges of lanes to the left of the own one, of a ``clearance``; empty: all.
    """

    kind: str
    rule: Rule
    value: Number
    edge: Edge = "none"
    delay: int = 0
    entities: tuple[int, ...] = ()
    every: bool = False
    other: int = -1
    along: bool = True
    free: bool = False
    place: Place | None = None
    events: tuple[int, ...] = ()
    state: str = ""
    begin: Literal["event", "act", "story"] = "event"
    act: int = -1
    direction: Direction = ""
    variable: int = -1
    against: tuple[int, ...] = ()
    reach: tuple[Number, ...] = ()
    lanes: tuple[tuple[int, int], ...] = ()


Trigger: TypeAlias = tuple[tuple[int, ...], ...]
"""Indices of conditions: one group of them must be met as a whole."""


@dataclass(frozen=True)
class Event:
    """Actions that begin together.

    Attributes:
        name: Name in the file.
        act: Index of its act.
        maneuver: Index of its maneuver.
        trigger: Its start; empty: with the act.
        actions: Indices of its actions.
        overrides: Whether it ends the other events of its maneuver.
        count: How often it may begin.
        whole: Index of the event of which it stands for one action; -1: none.
        waits: Whether it does not begin while another event of its maneuver is running.
    """

    name: str
    act: int
    maneuver: int
    trigger: Trigger
    actions: tuple[int, ...]
    overrides: bool
    count: int = 1
    waits: bool = False
    whole: int = -1


@dataclass(frozen=True)
class Group:
    """Maneuver group that is executed several times, each time when all its events are over."""

    count: int
    events: tuple[int, ...]


@dataclass(frozen=True)
class Starts:
    """Start as the file gives it.

    Attributes:
        places: Place of each vehicle.
        speeds: Its speed.
        adjustments: What moves a vehicle at once from there.
        actions: Actions that begin with the scene.
        routes: Roads that a vehicle is to drive over.
    """

    places: tuple[Place, ...]
    speeds: tuple[TargetSpeed, ...]
    adjustments: tuple[Gap | Teleport, ...]
    actions: tuple[Action, ...]
    routes: Mapping[int, Sequence[RoadMap]]


@dataclass(frozen=True)
class Storyboard(Starts):
    """All that happens.

    Attributes:
        acts: Start of each act.
        stops: Its end; None: only that of its events.
        events: Events of all acts.
        actions: Actions of all events.
        conditions: Conditions of all triggers.
        variables: Value of each variable at the start.
        groups: Maneuver groups that are executed several times.
    """

    acts: tuple[Trigger, ...]
    stops: tuple[Trigger | None, ...]
    events: tuple[Event, ...]
    conditions: tuple[Condition, ...]
    variables: tuple[Number, ...] = ()
    groups: tuple[Group, ...] = ()
