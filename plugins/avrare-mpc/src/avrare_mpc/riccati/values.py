"""Arguments of the kernels: named tuples, which compiled and plain Python read alike.

H is the number of steps, V of other vehicles, C of lanes. States are x, y, speed, heading; inputs are
acceleration, turn rate. Soft bounds are those of y, speed and heading, in this order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from avrare_mpc.riccati.jit import kernel

Floats = NDArray[np.float64]


class Programme(NamedTuple):
    """Weights, goals and bounds of ``MpcConfig`` and the scene; SI units.

    Attributes:
        dt: Step.
        centres: (C,) lane centres.
        reach_x: (V,) wanted distance between centres along the road at standstill.
        reach_y: (V,) the same across the road.
        lead_speed: Factor of speed x sin(heading) in the lateral reach.
        lead_acceleration: Factor of acceleration x sin(heading) in the lateral reach.
        final_turn_rate: Weight of the last turn rate: cost of the last node with its optimal input.
        lateral_max: Bound of |speed x turn rate|; infinite where there is none.
        low: (3,) lower soft bounds.
        high: (3,) upper soft bounds.
        penalty: (3,) weight of each unit beyond a soft bound.
    """

    dt: float
    centres: Floats
    reach_x: Floats
    reach_y: Floats
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
    final_turn_rate: float
    lane_weight: float
    obstacle_weight: float
    sharpness: float
    acceleration_max: float
    turn_rate_max: float
    lateral_max: float
    low: Floats
    high: Floats
    penalty: Floats


class Bounds(NamedTuple):
    """Number of bounds that count; the rows of ``Workspace`` have them in this order.

    Attributes:
        hard: 4: acceleration and turn rate; 6: lateral acceleration, too.
        soft: 1: y; 3: speed and heading, too.
    """

    hard: int
    soft: int


class Others(NamedTuple):
    """Predicted positions of the other vehicles, x and y (V, H + 1)."""

    x: Floats
    y: Floats


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
        cosine: (H + 1,) of the heading.
        sine: (H + 1,) of the heading.
        overlap: (H + 1, V) smoothed missing clearance [m].
        slope: (H + 1, V) its derivative with respect to the missing clearance.
        along: (H + 1, V) 1 where the clearance along the road counts, 0 where that across does.
        inside: (H, 6) distances to the soft bounds plus slack: low y, high y, low speed, ...
        outside: (H, 6) the slacks.
    """

    inputs: Floats
    states: Floats
    cosine: Floats
    sine: Floats
    overlap: Floats
    slope: Floats
    along: Floats
    inside: Floats
    outside: Floats


class Workspace(NamedTuple):
    """Memory of one search, reused for every particle.

    Attributes:
        box: (H, 6) multipliers of the hard bounds: low a, high a, low w, high w, low v w, high v w.
        box_move: (H, 6) their Newton direction.
        soft: (H, 6) multipliers of the soft bounds.
        soft_move: (H, 6) their Newton direction.
        gains: (H, 12) change of a, then of w: constant, and by x, y, v, h, previous w.
        move: (H, 3) direction of the inputs, and of v w.
        drift: (H, 3) direction of y, v, h at nodes 1..H.
    """

    box: Floats
    box_move: Floats
    soft: Floats
    soft_move: Floats
    gains: Floats
    move: Floats
    drift: Floats


@kernel
def new_workspace(steps: int) -> Workspace:
    """Allocate memory for plans of ``steps`` steps."""
    return Workspace(
        np.zeros((steps, 6)),
        np.zeros((steps, 6)),
        np.zeros((steps, 6)),
        np.zeros((steps, 6)),
        np.zeros((steps, 12)),
        np.zeros((steps, 3)),
        np.zeros((steps, 3)),
    )


@kernel
def new_path(steps: int, others: int) -> Path:
    """Allocate a trajectory of ``steps`` steps around ``others`` vehicles."""
    nodes = steps + 1
    return Path(
        np.zeros((steps, 2)),
        np.zeros((nodes, 4)),
        np.zeros(nodes),
        np.zeros(nodes),
        np.zeros((nodes, others)),
        np.zeros((nodes, others)),
        np.zeros((nodes, others)),
        np.zeros((steps, 6)),
        np.zeros((steps, 6)),
    )
