"""Values that the parts of a driving stack exchange.

SI units throughout: metres, seconds, radians. The frame is the road's: x along it and y to the left; headings
are counter-clockwise from its direction; positions are the centres of the vehicles' rectangles. On a straight
road that is the plane. On a bent one x is the station and y the offset of its reference line, and
``to_plane`` converts where shapes and lines of sight matter.
N is the number of particles, V the number of other vehicles, H the number of predicted steps.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from avrare.driving.reference_line import ReferenceLine

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Vehicles:
    """Kinematic state of vehicles: every field (N,) for the ego, (N, V) for the others.

    Attributes:
        x: Position along the road [m].
        y: Position across the road, left is positive [m].
        heading: Direction of the body [rad].
        speed: Speed along the heading [m/s].
        acceleration: Mean acceleration over the last step, (v[t] - v[t-1]) / dt [m/s^2].
    """

    x: Floats
    y: Floats
    heading: Floats
    speed: Floats
    acceleration: Floats


@dataclass(frozen=True, eq=False)
class Lane:
    """Lane whose borders vary: y of both at stations, linear between them.

    Attributes:
        stations: (K,) x from the lane's begin to its end, ascending [m].
        right: (K,) y of the right border [m].
        left: (K,) y of the left border [m].
    """

    stations: Floats
    right: Floats
    left: Floats


@dataclass(frozen=True, eq=False)
class Crossing:
    """Conflict area of the ego's way and a way whose traffic has priority over the ego.

    Attributes:
        reason: Why it has priority: it comes from the right, signs say so, or the ego turns left before it.
        begin: Least station of the area along the ego's way [m].
        end: Greatest station of the area along the ego's way [m].
        line: The other way, in the plane.
        line_begin: Station on ``line`` where the area begins [m].
        line_end: Station on ``line`` where it ends [m].
        half_width: Half the width of the other way [m].
        users: Indices of the other vehicles that take this way, as seen afterwards; None: unknown, any may.
        way: Number of the other way in the signal ``others_way``, which marks who takes it; or None.
        ego_line: The ego's way, in the plane; None: stations are the x of the road.
    """

    reason: Literal["right", "sign", "oncoming"]
    begin: float
    end: float
    line: ReferenceLine
    line_begin: float
    line_end: float
    half_width: float
    users: tuple[int, ...] | None = None
    way: int | None = None
    ego_line: ReferenceLine | None = None


GREEN, YELLOW, RED = 0.0, 1.0, 2.0
"""Values of the signals ``light_0``, ... of traffic lights; one that is out of order is GREEN."""


@dataclass(frozen=True)
class Road:
    """Lanes along a reference line.

    Attributes:
        lane_centres: y coordinate of each lane's centre, from right to left [m]; the median where it varies.
        lane_width: Width of every lane [m]; the median where it varies.
        access_ramp: Indices of the lanes that are an access ramp, not the main carriageway.
        begin: Least x in pictures [m].
        end: Greatest x in pictures [m].
        line: Reference line; None: the x axis of the plane.
        lanes: Lanes with borders of their own, in the order of ``lane_centres``; empty: parallel ones.
        shoulder: Indices of the lanes that are a shoulder.
        opposing: Indices of the lanes whose traffic goes towards smaller x.
        broad_markings: Indices of the lanes whose left border is a broad marking.
        stop_signs: x of the stop lines at which a stop sign stands [m].
        crossings: Conflict areas in which others have priority over the ego.
        light_lines: x of the stop lines of traffic lights [m]; the signal ``light_k`` is the k-th's colour.
        paths: (K, 2) centre lines of lanes in the plane, for pictures of a road without ``lane_centres`` [m].
    """

    lane_centres: tuple[float, ...]
    lane_width: float
    access_ramp: tuple[int, ...] = ()
    begin: float = 0.0
    end: float = 200.0
    line: ReferenceLine | None = None
    lanes: tuple[Lane, ...] = ()
    shoulder: tuple[int, ...] = ()
    opposing: tuple[int, ...] = ()
    broad_markings: tuple[int, ...] = ()
    stop_signs: tuple[float, ...] = ()
    crossings: tuple[Crossing, ...] = ()
    light_lines: tuple[float, ...] = ()
    paths: tuple[Floats, ...] = ()


@dataclass(frozen=True)
class Scene:
    """Scene: road, sizes and names, which do not change during a rollout.

    Attributes:
        dt: Duration of a step [s].
        road: Road.
        ego_length: Length of the ego's rectangle [m].
        ego_width: Width of the ego's rectangle [m].
        names: Name of each other vehicle, V entries.
        lengths: (V,) lengths of the others' rectangles [m].
        widths: (V,) widths of the others' rectangles [m].
        moving: (V,) False for parked vehicles.
    """

    dt: float
    road: Road
    ego_length: float
    ego_width: float
    names: tuple[str, ...]
    lengths: Floats
    widths: Floats
    moving: Bools


@dataclass(frozen=True)
class World:
    """State of a driving simulator.

    Attributes:
        step: (N,) number of steps since the start.
        ego: State of the ego, fields (N,).
        others: States of the other vehicles, fields (N, V).
        steering: (N,) steering angle of the ego [rad].
        weather: (N,) factor on the errors of perception and on the odds of a miss; None: 1 everywhere.
    """

    step: NDArray[np.int64]
    ego: Vehicles
    others: Vehicles
    steering: Floats
    weather: Floats | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class ObservingEgo(Vehicles):
    """Ego of a simulator that makes its observation itself.

    Attributes:
        observation: (N, D) numbers that a policy acts on.
    """

    observation: Floats


@dataclass(frozen=True)
class Observation:
    """Report of the perception system, in the world frame: S slots, each with a detection or empty.

    The first V slots belong to the other vehicles, one each; slots beyond them hold false detections
    (ghosts). A tracker that gets the identity of detections reads the slot as a label; one that finds out
    itself (it has a ``known_scene``) takes the slots for a list in no order.

    Attributes:
        detected: (N, S) whether there is a detection; where False the other fields are NaN.
        x: (N, S) position along the road [m].
        y: (N, S) position across the road [m].
        speed_x: (N, S) velocity along x [m/s].
        speed_y: (N, S) velocity along y [m/s]; None: not reported.
        heading: (N, S) heading of the detected box [rad]; None: not reported.
    """

    detected: Bools
    x: Floats
    y: Floats
    speed_x: Floats
    speed_y: Floats | None = None
    heading: Floats | None = None


@dataclass(frozen=True)
class Prediction:
    """Predicted positions of the others; entry 0 is the tracker's current estimate.

    A vehicle that the tracker does not know of is infinitely far away: x and y are inf, and it does not exist
    for the controller. NaN is an error. V counts the vehicles of the scene that the controller was built for,
    which may have more of them than the world (``Tracker.known_scene``).

    Attributes:
        x: (N, V, H + 1) position along the road [m].
        y: (N, V, H + 1) position across the road [m].
    """

    x: Floats
    y: Floats


def extrapolate(others: Vehicles, steps: int, dt: float) -> Prediction:
    """Return the positions of vehicles (N, V) now and over ``steps`` steps at their present velocities."""
    times = dt * np.arange(steps + 1)
    way = others.speed[:, :, None] * times
    heading = others.heading[:, :, None]
    return Prediction(
        others.x[:, :, None] + way * np.cos(heading), others.y[:, :, None] + way * np.sin(heading)
    )


@dataclass(frozen=True)
class Action:
    """Command of a controller for one step.

    Attributes:
        acceleration: (N,) demanded acceleration [m/s^2].
        yaw_rate: (N,) demanded yaw rate [rad/s].
    """

    acceleration: Floats
    yaw_rate: Floats


def to_plane(road: Road, vehicles: Vehicles) -> Vehicles:
    """Return vehicles of the road's frame in the plane."""
    if road.line is None:
        return vehicles
    x, y, heading, _ = road.line.frame(vehicles.x)
    return dataclasses.replace(
        vehicles,
        x=x - vehicles.y * np.sin(heading),
        y=y + vehicles.y * np.cos(heading),
        heading=vehicles.heading + heading,
    )


def to_road(line: ReferenceLine, vehicles: Vehicles) -> Vehicles:
    """Return vehicles of the plane in the frame of a line; NaN where they have no foot on it."""
    s, d = line.to_road(vehicles.x, vehicles.y)
    return dataclasses.replace(vehicles, x=s, y=d, heading=vehicles.heading - line.heading(s))


def world_in_plane(road: Road, world: World) -> World:
    """Return a world of the road's frame in the plane."""
    if road.line is None:
        return world
    return dataclasses.replace(world, ego=to_plane(road, world.ego), others=to_plane(road, world.others))
