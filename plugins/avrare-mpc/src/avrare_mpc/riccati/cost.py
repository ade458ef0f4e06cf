"""Cost of a drive, and its barrier."""

from __future__ import annotations

import math

from avrare_mpc.riccati.jit import kernel
from avrare_mpc.riccati.values import Floats, Others, Path, Programme

NEGLIGIBLE = -37.0
"""Below this scaled clearance a softplus is under 1e-16 and counts as nothing."""


@kernel
def lane_terms(y: float, centres: Floats) -> tuple[float, float, float]:
    """1 / sum(1 / d^2) over the lanes, its slope, and its Gauss-Newton curvature.

    Written in ratios to the nearest lane's distance, so that a lane's centre is no special place.
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
def drive_cost(p: Programme, path: Path, others: Others) -> float:
    """Cost of a drive without its bounds; fills what the derivatives share with it."""
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
def barrier(p: Programme, path: Path, bounds: int, mu: float) -> float:
    """Penalties and barriers of the bounds at parameter ``mu``; fills the path's distances and slacks.

    A soft bound g >= 0 costs the least of penalty t - mu log(t) - mu log(g + t) over slacks t, which has a
    closed form. Only the first ``bounds`` soft bounds count.
    """
    total = 0.0
    for k in range(len(path.inputs)):
        a, w = path.inputs[k, 0], path.inputs[k, 1]
        product = (a + p.acceleration_max) * (p.acceleration_max - a)
        product *= (w + p.turn_rate_max) * (p.turn_rate_max - w)
        for j in range(bounds):
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
    """The sum g + t and the slack t where penalty t - mu log(t) - mu log(g + t) is least.

    Written without cancellation, whichever of the two is small.
    """
    ratio = mu / penalty
    small = 2.0 * ratio * ratio / (abs(gap) + math.sqrt(gap * gap + 4.0 * ratio * ratio)) + ratio
    return (small + gap, small) if gap > 0.0 else (small, small - gap)


@kernel
def penalties(p: Programme, path: Path) -> tuple[float, float]:
    """The penalty of leaving the soft bound of y, and the farthest that speed or heading leave theirs."""
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
