"""Arguments of the kernels: named tuples, which compiled and plain Python read alike.

H is the number of steps, V of other vehicles, C of lanes of the road. States are x, y, speed, heading; inputs
are acceleration, turn rate. Soft bounds are those of y, speed and heading, in this order.

A ``Memory`` holds rows of lanes (``avrare_mpc.riccati.lanes``): row k * columns + column of an array
(H, columns) below, but in ``Programme``, where it holds plain numbers.
"""

from __future__ import annotations

from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from avrare_mpc.riccati.jit import COMPILED
from avrare_mpc.riccati.lanes import WIDTH, Memory

Floats = NDArray[np.float64]
LAST = 12
"""Row of ``Workspace.status`` with the turn rate before the plan; the others are those of ``newton``."""


class Programme(NamedTuple):
    """Weights, goals and bounds of ``MpcConfig`` and the scene; SI units.

    Attributes:
        steps: H.
        vehicles: V.
        road_lanes: C.
        dt: Step.
        centres: (C,) lane centres.
        reach_x: (V,) wanted distance between centres along the road at standstill.
        reach_y: (V,) the same across the road.
        lead_speed: Factor of speed x sin(heading) in the lateral reach.
        lead_acceleration: Factor of acceleration x sin(heading) in the lateral reach.
        start_change_weight: Weight of the difference of the first turn rate from the last one driven.
        final_turn_rate: Weight of the last turn rate: cost of the last node with its optimal input.
        lateral_max: Bound of |speed x turn rate|; infinite where there is none.
        low: (3,) lower soft bounds.
        high: (3,) upper soft bounds.
        penalty: (3,) weight of each unit beyond a soft bound.
    """

    steps: int
    vehicles: int
    road_lanes: int
    dt: float
    centres: Memory
    reach_x: Memory
    reach_y: Memory
    lead_speed: float
    lead_acceleration: float
    y_goal: float
    y_goal_weight: float
    v_goal: float
    v_goal_weight: float
    heading_weight: float
    acceleration_weight: float
    braking_weight: float
    turn_rate_weight: float
    turn_rate_change_weight: float
    start_change_weight: float
    final_turn_rate: float
    lane_weight: float
    obstacle_weight: float
    sharpness: float
    acceleration_max: float
    turn_rate_max: float
    lateral_max: float
    low: Memory
    high: Memory
    penalty: Memory


class Bounds(NamedTuple):
    """Number of bounds that count; the columns of ``Workspace`` have them in this order.

    Attributes:
        hard: 2: acceleration and turn rate; 3: lateral acceleration, too.
        soft: 1: y; 3: speed and heading, too.
    """

    hard: int
    soft: int


class Tuning(NamedTuple):
    """Schedule of the barrier and end of the search.

    Attributes:
        start: First barrier parameter, relative to the cost.
        end: Last one, relative to the cost.
        reduce: Factor from one barrier parameter to the next.
        step: Move of the inputs, relative to their bounds, below which the search has converged.
        iterations: Maximum number of iterations.
    """

    start: float
    end: float
    reduce: float
    step: float
    iterations: int


class Path(NamedTuple):
    """Trajectory with the terms that its cost and its derivatives share.

    Attributes:
        inputs: (H, 2).
        states: (H + 1, 4).
        turn: (H + 1, 2) cosine and sine of the heading.
        lane: (H + 1, 2) first and second derivative of the cost of the lanes by y.
        push: (H + 1, 4 V) of each vehicle's clearance cost, by the missing clearance, the first and second
            derivative; then the sign of that by x, or by y, where the one or the other counts.
        slack: (H, 6) of the soft bounds low y, high y, low speed, ...: the slack or the distance with it,
            whichever is smaller.
    """

    inputs: Memory
    states: Memory
    turn: Memory
    lane: Memory
    push: Memory
    slack: Memory


class Workspace(NamedTuple):
    """Memory of the searches in progress, one in each lane.

    Attributes:
        others: (H + 1, 2 V) predicted positions x and y of each other vehicle.
        box: (H, 6) multipliers of the hard bounds low a, high a, low w, high w, low v w, high v w.
        box_move: (H, 6) their Newton direction.
        nearness: (H, 6) 1 / distance to the hard bounds.
        soft: (H, 6) multipliers of the soft bounds.
        soft_move: (H, 6) their Newton direction; before, stiffness over what makes the multiplier move.
        stiffness: (H, 6) curvature of the soft bounds.
        force: (H, 3) slope of the soft bounds.
        gains: (H, 12) change of a, then of w: constant, and by x, y, v, h, previous w.
        move: (H, 3) direction of the inputs, and of v w.
        drift: (H, 3) direction of y, v, h at nodes 1..H.
        status: (1, 16) the progress of each search (``avrare_mpc.riccati.newton``).
    """

    others: Memory
    box: Memory
    box_move: Memory
    nearness: Memory
    soft: Memory
    soft_move: Memory
    stiffness: Memory
    force: Memory
    gains: Memory
    move: Memory
    drift: Memory
    status: Memory


def new_memory(steps: int, vehicles: int) -> tuple[Floats, Path, Path, Workspace]:
    """Allocate two trajectories and a workspace; the array must outlive the tuples' use.

    Args:
        steps: H.
        vehicles: V.
    """
    nodes = steps + 1
    path = [steps * 2, nodes * 4, nodes * 2, nodes * 2, nodes * 4 * vehicles, steps * 6]
    work = [nodes * 2 * vehicles, *(steps * columns for columns in (6, 6, 6, 6, 6, 6, 3, 12, 3, 3)), 16]
    sizes = [*path, *path, *work]
    # a row begins where a cache line does
    whole = np.zeros((sum(sizes) + 1) * WIDTH)
    skip = -whole.ctypes.data % 64 // whole.itemsize
    rows = whole[skip : skip + sum(sizes) * WIDTH].reshape(-1, WIDTH)
    ends = list(accumulate(sizes))
    if COMPILED:  # not by memory(): a search of few particles would spend its time there
        begin = memory(rows)
        parts = [begin + (end - size) * rows.strides[0] for end, size in zip(ends, sizes, strict=True)]
    else:
        parts = [rows[end - size : end] for end, size in zip(ends, sizes, strict=True)]
    count = len(path)
    return rows, Path(*parts[:count]), Path(*parts[count : 2 * count]), Workspace(*parts[2 * count :])


def memory(array: Floats) -> Memory:
    """Return a contiguous array for kernels: its address where they are compiled."""
    return array.ctypes.data if COMPILED else array
