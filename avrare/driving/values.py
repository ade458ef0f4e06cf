"""What the parts of a driving stack hand to each other.

SI units throughout: metres, seconds, radians. The world frame has x along the road and y to the left;
headings are counter-clockwise from x; positions are the centres of the vehicles' rectangles.
N is the number of particles, V the number of other vehicles, H the number of predicted steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Vehicles:
    """Kinematic state of vehicles: every field (N,) for the ego, (N, V) for the others.

    Attributes:
        x: Position along the road [m].
        y: Position across the road, left is positive [m].
        heading: Direction of the body [rad].
        speed: Along the heading [m/s].
        acceleration: Realised over the last step, (v[t] - v[t-1]) / dt [m/s^2].
    """

    x: Floats
    y: Floats
    heading: Floats
    speed: Floats
    acceleration: Floats


@dataclass(frozen=True)
class Road:
    """Straight parallel lanes.

    Attributes:
        lane_centres: y of each lane's centre, from right to left [m].
        lane_width: Width of every lane [m].
        access_ramp: Indices of the lanes that are an access ramp, not the main carriageway.
        begin: First x that is drawn [m].
        end: Last x that is drawn [m].
    """

    lane_centres: tuple[float, ...]
    lane_width: float
    access_ramp: tuple[int, ...] = ()
    begin: float = 0.0
    end: float = 200.0


@dataclass(frozen=True)
class Scene:
    """What does not change during a run: road, sizes and names.

    Attributes:
        dt: Step [s].
        road: The road.
        ego_length: Ego rectangle [m].
        ego_width: Ego rectangle [m].
        names: Name of each other vehicle, V entries.
        lengths: (V,) [m].
        widths: (V,) [m].
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
    """State of a driving simulator that keeps nothing else.

    Attributes:
        step: (N,) number of steps since the start.
        ego: Fields (N,).
        others: Fields (N, V).
        steering: (N,) steering angle of the ego [rad].
    """

    step: NDArray[np.int64]
    ego: Vehicles
    others: Vehicles
    steering: Floats


@dataclass(frozen=True)
class Observation:
    """What the perception system reports of each other vehicle, in the world frame.

    Attributes:
        detected: (N, V); where False the other fields are NaN.
        x: (N, V) [m].
        y: (N, V) [m].
        speed_x: (N, V) velocity along x [m/s].
    """

    detected: Bools
    x: Floats
    y: Floats
    speed_x: Floats


@dataclass(frozen=True)
class Prediction:
    """Where the tracker expects the others; entry 0 is its estimate of now.

    Attributes:
        x: (N, V, H + 1) [m].
        y: (N, V, H + 1) [m].
    """

    x: Floats
    y: Floats


@dataclass(frozen=True)
class Action:
    """What a controller asks of the plant for one step.

    Attributes:
        acceleration: (N,) [m/s^2].
        yaw_rate: (N,) [rad/s].
    """

    acceleration: Floats
    yaw_rate: Floats
