"""Values of a storyboard: what vehicles do, and when. Numbers are columns of the parameters' table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from avrare_single_track.openscenario.parameters import Number

Form: TypeAlias = Literal["step", "linear", "cubic", "sinusoidal"]
FORMS: tuple[Form, ...] = ("step", "linear", "cubic", "sinusoidal")
"""Shapes of a transition."""
Dimension: TypeAlias = Literal["time", "distance", "rate"]
DIMENSIONS: tuple[Dimension, ...] = ("time", "distance", "rate")
"""What the length of a transition is given in; a rate is the highest one."""
Rule: TypeAlias = Literal["lessThan", "lessOrEqual", "greaterThan", "greaterOrEqual", "equalTo", "notEqualTo"]
Edge: TypeAlias = Literal["none", "rising", "falling", "risingOrFalling"]


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
            differences along and across its body.
        x: See above [m].
        y: The same [m].
        heading: Against the lane, or in the plane where ``absolute`` [rad].
        lane: Index of the lane of a ``lane``, or number of lanes to the left of the other's, of a ``beside``.
        other: Index of the other vehicle.
        absolute: Whether the heading is that in the plane.
    """

    kind: Literal["road", "plane", "lane", "beside", "ahead"]
    x: Number
    y: Number
    heading: Number
    lane: int | None = None
    other: int = -1
    absolute: bool = False


@dataclass(frozen=True)
class SpeedChange:
    """Action: a vehicle takes another speed.

    Attributes:
        actor: Index of the vehicle.
        transition: How.
        target: Speed, or what is added to the other's, or the factor on it [m/s].
        other: Index of the vehicle whose speed at the start counts, -1: none.
        factor: Whether the target is a factor.
    """

    actor: int
    transition: Transition
    target: Number
    other: int = -1
    factor: bool = False


@dataclass(frozen=True)
class LaneChange:
    """Action: a vehicle takes another place across the road.

    Attributes:
        actor: Index of the vehicle.
        transition: How.
        lane: Index of the lane, or number of lanes to the left of the other's.
        offset: Offset from the lane's centre [m].
        other: Index of the vehicle whose lane counts, -1: ``lane`` is the index.
    """

    actor: int
    transition: Transition
    lane: int
    offset: Number
    other: int = -1


Action: TypeAlias = SpeedChange | LaneChange


@dataclass(frozen=True)
class Condition:
    """Condition of a trigger.

    Attributes:
        kind: ``time``, ``travelled``, ``speed``, ``relative_speed``, ``standstill``, ``distance``,
            ``headway``, ``collision_time``, ``reach``, ``acceleration`` or ``state``.
        rule: Comparison with ``value``.
        value: What is compared with.
        edge: Change of the comparison that counts.
        delay: Steps after which it counts.
        entities: Vehicles that it is asked of; the ego is the last one.
        every: Whether all of them must meet it, or any.
        other: Vehicle that it is about besides.
        along: Whether a distance is one of stations, along the road; else in the plane.
        free: Whether it is between the boxes.
        place: Place that is to be reached, or that a distance is to.
        events: Events that a ``state`` is about.
        state: The state.
        begin: What its begin is: that of an event, of an act, or of the simulation.
        act: Index of that act.
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
    """

    name: str
    act: int
    maneuver: int
    trigger: Trigger
    actions: tuple[int, ...]
    overrides: bool


@dataclass(frozen=True)
class Storyboard:
    """All that happens.

    Attributes:
        places: Start of each vehicle.
        speeds: Its speed at the start.
        acts: Start of each act.
        events: Events of all acts.
        actions: Actions of all events.
        conditions: Conditions of all triggers.
    """

    places: tuple[Place, ...]
    speeds: tuple[Number, ...]
    acts: tuple[Trigger, ...]
    events: tuple[Event, ...]
    actions: tuple[Action, ...]
    conditions: tuple[Condition, ...]
