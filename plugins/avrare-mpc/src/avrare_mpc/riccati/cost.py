"""Cost of a trajectory, its barrier, and the quadratic model of each stage.

The model omits second derivatives of the clearances and of the lane distances (Gauss-Newton), so that every
stage is convex; with them a search takes as many iterations.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from avrare_mpc.riccati.jit import kernel
from avrare_mpc.riccati.values import Bounds, Floats, Others, Path, Programme

NEGLIGIBLE = -37.0
"""Scaled clearance below which a softplus is under 1e-16 and taken as 0."""


class Stage(NamedTuple):
    """Gradient and Hessian by x, y, v, h and a of every term but turn rates and bounds; xy is 0."""

    x: float
    y: float
    v: float
    h: float
    a: float
    xx: float
    xv: float
    xh: float
    xa: float
    yy: float
    yv: float
    yh: float
    ya: float
    vv: float
    vh: float
    va: float
    hh: float
    ha: float
    aa: float


@kernel
def lane_terms(y: float, centres: Floats) -> tuple[float, float, float]:
    """Return 1 / sum(1 / d^2) over the lanes, its slope, and its Gauss-Newton curvature.

    Ratios to the nearest lane's distance make it regular on a lane's centre.
    """
    near = y - centres[0]
    for i in range(1, len(centres)):
        if abs(y - centres[i]) < abs(near):
            near = y - centres[i]
    squares = cubes = 0.0
    for i in range(len(centres)):
        distance = y - centres[i]
        ratio = 1.0 if distance == near else near / distance
        square = ratio * ratio
        squares += square
        cubes += square * ratio
    pull = cubes / squares
    return near * near / squares, 2.0 * near * pull / squares, 2.0 * pull * pull / squares


@kernel
def path_cost(p: Programme, path: Path, others: Others) -> float:
    """Return the cost of a trajectory without its bounds; fills the terms shared with the derivatives."""
    steps, before, cost = len(path.inputs), 0.0, 0.0
    for k in range(steps + 1):
        a = w = 0.0
        if k < steps:
            a, w = path.inputs[k, 0], path.inputs[k, 1]
            brake = min(a, 0.0)
            cost += p.acceleration_weight * a * a + p.braking_weight * brake * brake
            cost += p.turn_rate_weight * w * w
            if k > 0:
                cost += p.turn_rate_change_weight * (w - before) * (w - before)
        else:
            cost += p.final_turn_rate * before * before
        y, v, h = path.states[k, 1], path.states[k, 2], path.states[k, 3]
        cost += p.y_goal_weight * (y - p.y_goal) * (y - p.y_goal)
        cost += p.v_goal_weight * (v - p.v_goal) * (v - p.v_goal) + p.heading_weight * h * h
        cost += p.lane_weight * lane_terms(y, p.centres)[0]
        cost += _clearance_cost(p, path, k, a, others)
        before = w
    return cost


@kernel
def _clearance_cost(p: Programme, path: Path, k: int, a: float, others: Others) -> float:
    x, y, v = path.states[k, 0], path.states[k, 1], path.states[k, 2]
    lead_x = (v * p.dt + a * p.dt * p.dt) * path.cosine[k]
    lead_y = (v * p.lead_speed + a * p.lead_acceleration) * path.sine[k]
    cost = 0.0
    for i in range(len(p.reach_x)):
        missing_x = p.reach_x[i] + lead_x - abs(x - others.x[i, k])
        missing_y = p.reach_y[i] + lead_y - abs(y - others.y[i, k])
        path.along[k, i] = 1.0 if missing_x < missing_y else 0.0
        scaled = p.sharpness * min(missing_x, missing_y)
        overlap = slope = 0.0
        if scaled > NEGLIGIBLE:
            small = math.exp(-abs(scaled))
            overlap = (max(scaled, 0.0) + math.log1p(small)) / p.sharpness
            slope = (1.0 if scaled > 0.0 else small) / (1.0 + small)
        path.overlap[k, i], path.slope[k, i] = overlap, slope
        cost += p.obstacle_weight * overlap * overlap
    return cost


@kernel
def barrier(p: Programme, path: Path, bounds: Bounds, mu: float) -> float:
    """Return penalties and barriers of the bounds at parameter ``mu``; fills the path's distances and slacks.

    A soft bound g >= 0 costs min over slacks t of penalty t - mu log(t) - mu log(g + t), in closed form.
    Only the first ``bounds.soft`` soft bounds count.
    """
    total = 0.0
    for k in range(len(path.inputs)):
        a, w = path.inputs[k, 0], path.inputs[k, 1]
        product = (a + p.acceleration_max) * (p.acceleration_max - a)
        product *= (w + p.turn_rate_max) * (p.turn_rate_max - w)
        if bounds.hard > 4:
            lateral = path.states[k, 2] * w
            product *= (lateral + p.lateral_max) * (p.lateral_max - lateral)
        for j in range(bounds.soft):
            value, penalty = path.states[k + 1, j + 1], p.penalty[j]
            for side in range(2):
                gap = value - p.low[j] if side == 0 else p.high[j] - value
                inside, outside = slacks(gap, penalty, mu)
                path.inside[k, 2 * j + side], path.outside[k, 2 * j + side] = inside, outside
                total += penalty * outside
                product *= inside * outside * (penalty / mu)
        total -= mu * math.log(product)
    return total


@kernel
def slacks(gap: float, penalty: float, mu: float) -> tuple[float, float]:
    """Return g + t and t at the minimum over t of penalty t - mu log(t) - mu log(g + t).

    Free of cancellation, whichever of the two is small.
    """
    ratio = mu / penalty
    small = 2.0 * ratio * ratio / (abs(gap) + math.sqrt(gap * gap + 4.0 * ratio * ratio)) + ratio
    return (small + gap, small) if gap > 0.0 else (small, small - gap)


@kernel
def penalties(p: Programme, path: Path) -> tuple[float, float]:
    """Return the penalty of y beyond its soft bound, and the largest violation by speed or heading."""
    penalty = excess = 0.0
    for k in range(1, len(path.states)):
        for j in range(3):
            value = path.states[k, j + 1]
            out = max(p.low[j] - value, value - p.high[j], 0.0)
            if j == 0:
                penalty += p.penalty[0] * out
            else:
                excess = max(excess, out)
    return penalty, excess


@kernel
def stage_model(p: Programme, path: Path, k: int, a: float, others: Others) -> Stage:
    """Return the model at node ``k`` with acceleration ``a``."""
    y, v, h = path.states[k, 1], path.states[k, 2], path.states[k, 3]
    _, slope, curve = lane_terms(y, p.centres)
    effort = 2.0 * (p.acceleration_weight + (p.braking_weight if a < 0.0 else 0.0))
    slope_y = 2.0 * p.y_goal_weight * (y - p.y_goal) + p.lane_weight * slope
    slope_v = 2.0 * p.v_goal_weight * (v - p.v_goal)
    model = Stage(
        0.0, slope_y, slope_v, 2.0 * p.heading_weight * h, effort * a,
        0.0, 0.0, 0.0, 0.0,
        2.0 * p.y_goal_weight + p.lane_weight * curve, 0.0, 0.0, 0.0,
        2.0 * p.v_goal_weight, 0.0, 0.0,
        2.0 * p.heading_weight, 0.0,
        effort,
    )  # fmt: skip
    for i in range(len(p.reach_x)):
        if path.slope[k, i] > 0.0:
            model = _add_clearance(p, path, k, i, a, others, model)
    return model


@kernel
def _add_clearance(p: Programme, path: Path, k: int, i: int, a: float, others: Others, to: Stage) -> Stage:
    # 1. Derivatives of the cost by the missing clearance.
    overlap, slope = path.overlap[k, i], path.slope[k, i]
    force = 2.0 * p.obstacle_weight * overlap * slope
    curve = slope * slope + overlap * p.sharpness * slope * (1.0 - slope)
    curve = 2.0 * p.obstacle_weight * curve
    # 2. Derivatives of the missing clearance by x, y, v, h and a.
    c, s, speed = path.cosine[k], path.sine[k], path.states[k, 2]
    x = y = 0.0
    if path.along[k, i] > 0.0:
        x = 1.0 if path.states[k, 0] < others.x[i, k] else -1.0
        v, h, acc = c * p.dt, -s * (speed * p.dt + a * p.dt * p.dt), c * p.dt * p.dt
    else:
        y = 1.0 if path.states[k, 1] < others.y[i, k] else -1.0
        lead = speed * p.lead_speed + a * p.lead_acceleration
        v, h, acc = s * p.lead_speed, c * lead, s * p.lead_acceleration
    # 3. Chain rule.
    return Stage(
        to.x + force * x, to.y + force * y, to.v + force * v, to.h + force * h, to.a + force * acc,
        to.xx + curve * x * x, to.xv + curve * x * v, to.xh + curve * x * h, to.xa + curve * x * acc,
        to.yy + curve * y * y, to.yv + curve * y * v, to.yh + curve * y * h, to.ya + curve * y * acc,
        to.vv + curve * v * v, to.vh + curve * v * h, to.va + curve * v * acc,
        to.hh + curve * h * h, to.ha + curve * h * acc,
        to.aa + curve * acc * acc,
    )  # fmt: skip
