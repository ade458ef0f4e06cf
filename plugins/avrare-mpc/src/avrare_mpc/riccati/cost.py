"""Cost of trajectories, their barrier, and the quadratic model of each stage.

The model omits second derivatives of the clearances and of the lane distances (Gauss-Newton), so that every
stage is convex; with them a search takes as many iterations.
"""

from __future__ import annotations

from typing import NamedTuple

from avrare_mpc.riccati.functions import larger, logarithm, smaller, softplus
from avrare_mpc.riccati.jit import kernel
from avrare_mpc.riccati.lanes import (
    Lanes,
    any_of,
    exponent,
    load,
    magnitude,
    mantissa,
    peek,
    root,
    select,
    splat,
    store,
)
from avrare_mpc.riccati.values import LAST, Bounds, Path, Programme, Workspace

NEGLIGIBLE = -37.0
"""Scaled clearance below which a softplus is under 1e-16 and taken as 0."""
LINEAR = 37.0
"""Scaled clearance above which a softplus is its argument."""
INFINITE = 1e300
"""Barrier of a path on a bound."""


class Stage(NamedTuple):
    """Gradient and Hessian by x, y, v, h and a of every term but turn rates and bounds; its xy is 0."""

    grad_x: Lanes
    grad_y: Lanes
    grad_v: Lanes
    grad_h: Lanes
    grad_a: Lanes
    xx: Lanes
    xv: Lanes
    xh: Lanes
    xa: Lanes
    yy: Lanes
    yv: Lanes
    yh: Lanes
    ya: Lanes
    vv: Lanes
    vh: Lanes
    va: Lanes
    hh: Lanes
    ha: Lanes
    aa: Lanes


@kernel
def lane_terms(p: Programme, y: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """Return 1 / sum(1 / d^2) over the lanes, its slope, and its Gauss-Newton curvature.

    With P the product of all d, S the sum over lanes of the squared products of the others' d, and U that of
    their cubes, they are P^2 / S, 2 P U / S^2 and 2 U^2 / S^3: regular on a lane's centre.
    """
    product, squares, cubes = splat(1.0), splat(0.0), splat(0.0)
    for i in range(p.road_lanes):
        d = y - peek(p.centres, i)
        d2, product2 = d * d, product * product
        squares = squares * d2 + product2
        cubes = cubes * (d2 * d) + product2 * product
        product = product * d
    inverse = 1.0 / squares
    pull = cubes * inverse
    return product * product * inverse, 2.0 * product * pull * inverse, 2.0 * pull * pull * inverse


@kernel
def path_cost(p: Programme, path: Path, work: Workspace) -> Lanes:
    """Return the cost of trajectories without bounds; fills the terms shared with the derivatives."""
    before, cost = load(work.status, LAST), splat(0.0)
    for k in range(p.steps + 1):
        a, w = splat(0.0), splat(0.0)
        if k < p.steps:
            a, w = load(path.inputs, 2 * k), load(path.inputs, 2 * k + 1)
            brake = smaller(a, 0.0)
            effort = p.acceleration_weight * a * a + p.braking_weight * brake * brake
            cost = cost + (effort + p.turn_rate_weight * w * w)
            change = p.turn_rate_change_weight if k > 0 else p.start_change_weight
            cost = cost + change * (w - before) * (w - before)
        else:
            cost = cost + p.final_turn_rate * before * before
        y, v, h = load(path.states, 4 * k + 1), load(path.states, 4 * k + 2), load(path.states, 4 * k + 3)
        lane, slope, curve = lane_terms(p, y)
        store(path.lane, 2 * k, slope)
        store(path.lane, 2 * k + 1, curve)
        goals = p.y_goal_weight * (y - p.y_goal) * (y - p.y_goal)
        goals = goals + p.v_goal_weight * (v - p.v_goal) * (v - p.v_goal) + p.heading_weight * h * h
        cost = cost + (goals + p.lane_weight * lane)
        cost = cost + _clearance_cost(p, path, work, k, a)
        before = w
    return cost


@kernel
def _clearance_cost(p: Programme, path: Path, work: Workspace, k: int, a: Lanes) -> Lanes:
    x, y, v = load(path.states, 4 * k), load(path.states, 4 * k + 1), load(path.states, 4 * k + 2)
    lead_x = (v * p.dt + a * (p.dt * p.dt)) * load(path.turn, 2 * k)
    lead_y = (v * p.lead_speed + a * p.lead_acceleration) * load(path.turn, 2 * k + 1)
    cost, per_sharpness = splat(0.0), 1.0 / p.sharpness
    for i in range(p.vehicles):
        other, row = 2 * (p.vehicles * k + i), 4 * (p.vehicles * k + i)
        dx, dy = x - load(work.others, other), y - load(work.others, other + 1)
        missing_x = peek(p.reach_x, i) + lead_x - magnitude(dx)
        missing_y = peek(p.reach_y, i) + lead_y - magnitude(dy)
        scaled = p.sharpness * smaller(missing_x, missing_y)
        near = scaled > NEGLIGIBLE
        if any_of(near):
            soft, slope = softplus(larger(smaller(scaled, LINEAR), NEGLIGIBLE))
            soft = select(scaled > LINEAR, scaled, soft)
            overlap, slope = select(near, soft * per_sharpness, 0.0), select(near, slope, 0.0)
            weighted = p.obstacle_weight * overlap
            cost = cost + weighted * overlap
            store(path.push, row, 2.0 * weighted * slope)
            bend = slope * slope + overlap * p.sharpness * slope * (1.0 - slope)
            store(path.push, row + 1, 2.0 * p.obstacle_weight * bend)
            along = missing_x < missing_y
            store(path.push, row + 2, select(along, select(dx < 0.0, 1.0, splat(-1.0)), 0.0))
            store(path.push, row + 3, select(along, 0.0, select(dy < 0.0, 1.0, splat(-1.0))))
        else:
            store(path.push, row, 0.0)
            store(path.push, row + 1, 0.0)
    return cost


@kernel
def barrier(p: Programme, path: Path, bounds: Bounds, mu: Lanes) -> Lanes:
    """Return penalties and barriers of the bounds at parameter ``mu``; fills the path's slacks.

    A soft bound g >= 0 costs min over slacks t of penalty t - mu log(t) - mu log(g + t), in closed form.
    """
    total, product, power = splat(0.0), splat(1.0), splat(0.0)
    for k in range(p.steps):
        a, w = load(path.inputs, 2 * k), load(path.inputs, 2 * k + 1)
        here = (a + p.acceleration_max) * (p.acceleration_max - a)
        here = here * ((w + p.turn_rate_max) * (p.turn_rate_max - w))
        if bounds.hard > 2:
            lateral = load(path.states, 4 * k + 2) * w
            here = here * ((lateral + p.lateral_max) * (p.lateral_max - lateral))
        for j in range(bounds.soft):
            value, penalty = load(path.states, 4 * (k + 1) + j + 1), peek(p.penalty, j)
            low, high = value - peek(p.low, j), peek(p.high, j) - value
            small_low, small_high, sums = slacks(low, high, mu * (1.0 / penalty))
            store(path.slack, 6 * k + 2 * j, small_low)
            store(path.slack, 6 * k + 2 * j + 1, small_high)
            total = total + penalty * (outside(low, small_low) + outside(high, small_high))
            here = here * sums
        product, power = mantissa(product) * here, power + exponent(product)
    whole = total - mu * logarithm(product, power)
    return select(product > 0.0, whole, INFINITE)


@kernel
def slacks(low: Lanes, high: Lanes, ratio: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """Return for two gaps g the smaller of t and g + t at the minimum of penalty t - mu log(t (g + t)).

    The third value is the product of both t (g + t) penalty / mu: at the minimum each is (g + t) + t.

    Args:
        low: A gap, negative where its bound is violated.
        high: Another one.
        ratio: mu / penalty.
    """
    r2 = 4.0 * ratio * ratio
    size_low, size_high = magnitude(low), magnitude(high)
    root_low, root_high = root(low * low + r2), root(high * high + r2)
    sum_low, sum_high = size_low + root_low, size_high + root_high
    inverse = (0.5 * r2) / (sum_low * sum_high)
    sums = (root_low + 2.0 * ratio) * (root_high + 2.0 * ratio)
    return sum_high * inverse + ratio, sum_low * inverse + ratio, sums


@kernel
def outside(gap: Lanes, small: Lanes) -> Lanes:
    """Return the slack t of a gap; ``slacks`` gave the smaller of t and gap + t."""
    return select(gap > 0.0, small, small - gap)


@kernel
def inside(gap: Lanes, small: Lanes) -> Lanes:
    """Return gap + t."""
    return select(gap > 0.0, small + gap, small)


@kernel
def penalties(p: Programme, path: Path) -> tuple[Lanes, Lanes]:
    """Return the penalty of y beyond its soft bound, and the largest violation by speed or heading."""
    penalty, excess = splat(0.0), splat(0.0)
    for k in range(1, p.steps + 1):
        for j in range(3):
            value = load(path.states, 4 * k + j + 1)
            out = larger(larger(peek(p.low, j) - value, value - peek(p.high, j)), 0.0)
            if j == 0:
                penalty = penalty + peek(p.penalty, 0) * out
            else:
                excess = larger(excess, out)
    return penalty, excess


@kernel
def stage_model(p: Programme, path: Path, k: int, a: Lanes) -> Stage:
    """Return the model at node ``k`` with acceleration ``a``."""
    y, v, h = load(path.states, 4 * k + 1), load(path.states, 4 * k + 2), load(path.states, 4 * k + 3)
    effort = 2.0 * (p.acceleration_weight + select(a < 0.0, p.braking_weight, splat(0.0)))
    slope_y = 2.0 * p.y_goal_weight * (y - p.y_goal) + p.lane_weight * load(path.lane, 2 * k)
    none = splat(0.0)
    model = Stage(  # + 0.0: no -0.0, to which adding 0 would make a difference
        none, slope_y + 0.0, 2.0 * p.v_goal_weight * (v - p.v_goal) + 0.0,
        2.0 * p.heading_weight * h + 0.0, effort * a + 0.0,
        none, none, none, none,
        2.0 * p.y_goal_weight + p.lane_weight * load(path.lane, 2 * k + 1), none, none, none,
        splat(2.0 * p.v_goal_weight), none, none,
        splat(2.0 * p.heading_weight), none,
        effort,
    )  # fmt: skip
    for i in range(p.vehicles):
        if any_of(load(path.push, 4 * (p.vehicles * k + i) + 1) > 0.0):
            model = _add_clearance(p, path, k, i, a, model)
    return model


@kernel
def _add_clearance(p: Programme, path: Path, k: int, i: int, a: Lanes, to: Stage) -> Stage:
    # 1. Derivatives of the missing clearance by x, y, v, h and a
    row = 4 * (p.vehicles * k + i)
    c, s, speed = load(path.turn, 2 * k), load(path.turn, 2 * k + 1), load(path.states, 4 * k + 2)
    near = load(path.push, row + 1) > 0.0
    slope, curvature = load(path.push, row), load(path.push, row + 1)
    by_x = select(near, load(path.push, row + 2), 0.0)
    by_y = select(near, load(path.push, row + 3), 0.0)
    lead = speed * p.lead_speed + a * p.lead_acceleration
    along = by_x * by_x > 0.0
    by_v = select(along, c * p.dt, s * p.lead_speed)
    by_h = select(along, -s * (speed * p.dt + a * (p.dt * p.dt)), c * lead)
    by_a = select(along, c * (p.dt * p.dt), s * p.lead_acceleration)
    # 2. Chain rule
    scaled_x, scaled_y = curvature * by_x, curvature * by_y
    scaled_v, scaled_h = curvature * by_v, curvature * by_h
    return Stage(
        to.grad_x + slope * by_x, to.grad_y + slope * by_y,
        to.grad_v + slope * by_v, to.grad_h + slope * by_h, to.grad_a + slope * by_a,
        to.xx + scaled_x * by_x, to.xv + scaled_x * by_v, to.xh + scaled_x * by_h, to.xa + scaled_x * by_a,
        to.yy + scaled_y * by_y, to.yv + scaled_y * by_v, to.yh + scaled_y * by_h, to.ya + scaled_y * by_a,
        to.vv + scaled_v * by_v, to.vh + scaled_v * by_h, to.va + scaled_v * by_a,
        to.hh + scaled_h * by_h, to.ha + scaled_h * by_a,
        to.aa + curvature * by_a * by_a,
    )  # fmt: skip
