"""What the kernels work on: named tuples, which compiled and plain Python read alike.

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
    """Weights, goals and bounds, as ``MpcConfig`` and the scene have them; SI units.

    Attributes:
        dt: Step.
        reach_x: (V,) wanted distance of the centres along the road at standstill.
        reach_y: (V,) the same across the road.
        lead_speed: What the speed adds to the lateral reach, times sin(heading).
        lead_acceleration: What the acceleration adds, times sin(heading).
        final_turn_rate: Weight of the last turn rate: what the last node costs, its input solved for.
        low: (3,) lower soft bounds.
        high: (3,) upper soft bounds.
        penalty: (3,) weight of each unit outside.
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
    low: Floats
    high: Floats
    penalty: Floats


class Others(NamedTuple):
    """Where the other vehicles will be, x and y (V, H + 1)."""

    x: Floats
    y: Floats


class Tuning(NamedTuple):
    """How the barrier goes down and when the search ends.

    Attributes:
        start: First barrier parameter, relative to the cost.
        end: Last one, relative to the cost.
        reduce: Factor from one barrier parameter to the next.
        step: Inputs that move by less, relative to their bounds, have arrived.
        iterations: Most iterations.
    """

    start: float
    end: float
    reduce: float
    step: float
    iterations: int


class Path(NamedTuple):
    """A drive with what its derivatives share with its cost.

    Attributes:
        inputs: (H, 2).
        states: (H + 1, 4).
        cosine: (H + 1,) of the heading.
        sine: (H + 1,) of the heading.
        overlap: (H + 1, V) smoothed missing clearance [m].
        slope: (H + 1, V) its derivative by the missing clearance.
        along: (H + 1, V) 1 where the clearance along the road counts, 0 across.
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
    """Memory of one search, used again for every particle.

    Attributes:
        box: (H, 4) multipliers of the input bounds: low a, high a, low w, high w.
        box_move: (H, 4) their direction.
        soft: (H, 6) multipliers of the soft bounds.
        soft_move: (H, 6) their direction.
        gains: (H, 12) change of a, then of w: constant, by x, y, v, h, turn rate before.
        move: (H, 2) direction of the inputs.
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
    """Memory for plans of ``steps`` steps."""
    return Workspace(
        np.zeros((steps, 4)),
        np.zeros((steps, 4)),
        np.zeros((steps, 6)),
        np.zeros((steps, 6)),
        np.zeros((steps, 12)),
        np.zeros((steps, 2)),
        np.zeros((steps, 3)),
    )


@kernel
def new_path(steps: int, others: int) -> Path:
    """Memory for a drive of ``steps`` steps around ``others`` vehicles."""
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
