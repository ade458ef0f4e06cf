"""Second-order model of one stage: the derivatives of its cost by state and inputs.

Missing entries are zero by structure. Second derivatives of the clearances and of the lane distances are left
out (Gauss-Newton), so that every stage is convex; with them a search takes as many iterations.
"""

from __future__ import annotations

from typing import NamedTuple

from avrare_mpc.riccati.cost import lane_terms
from avrare_mpc.riccati.jit import kernel
from avrare_mpc.riccati.values import Others, Path, Programme


class Stage(NamedTuple):
    """Gradient and Hessian by x, y, v, h and a, of everything but turn rates and bounds."""

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
def stage_model(p: Programme, path: Path, k: int, a: float, others: Others) -> Stage:
    """The model at node ``k`` with acceleration ``a``."""
    y, v, h = path.states[k, 1], path.states[k, 2], path.states[k, 3]
    _, slope, curve = lane_terms(y, p.centres)
    braking = p.braking_weight if a < 0.0 else 0.0
    free = Stage(
        x=0.0,
        y=2.0 * p.y_goal_weight * (y - p.y_goal) + p.lane_weight * slope,
        v=2.0 * p.v_goal_weight * (v - p.v_goal),
        h=2.0 * p.heading_weight * h,
        a=2.0 * (p.acceleration_weight + braking) * a,
        xx=0.0,
        xv=0.0,
        xh=0.0,
        xa=0.0,
        yy=2.0 * p.y_goal_weight + p.lane_weight * curve,
        yv=0.0,
        yh=0.0,
        ya=0.0,
        vv=2.0 * p.v_goal_weight,
        vh=0.0,
        va=0.0,
        hh=2.0 * p.heading_weight,
        ha=0.0,
        aa=2.0 * (p.acceleration_weight + braking),
    )
    for i in range(len(p.reach_x)):
        if path.slope[k, i] > 0.0:
            if path.along[k, i] > 0.0:
                free = _add_along(p, path, k, i, a, others.x[i, k], free)
            else:
                free = _add_across(p, path, k, i, a, others.y[i, k], free)
    return free


@kernel
def _force(p: Programme, path: Path, k: int, i: int) -> tuple[float, float]:
    """First and second derivative of the clearance cost by the missing clearance."""
    overlap, slope = path.overlap[k, i], path.slope[k, i]
    curve = slope * slope + overlap * p.sharpness * slope * (1.0 - slope)
    return 2.0 * p.obstacle_weight * overlap * slope, 2.0 * p.obstacle_weight * curve


@kernel
def _add_along(p: Programme, path: Path, k: int, i: int, a: float, other_x: float, to: Stage) -> Stage:
    force, curve = _force(p, path, k, i)
    dt, c, s = p.dt, path.cosine[k], path.sine[k]
    lead = path.states[k, 2] * dt + a * dt * dt
    x = 1.0 if path.states[k, 0] < other_x else -1.0
    v, h, acc = c * dt, -s * lead, c * dt * dt
    return Stage(
        x=to.x + force * x,
        y=to.y,
        v=to.v + force * v,
        h=to.h + force * h,
        a=to.a + force * acc,
        xx=to.xx + curve,
        xv=to.xv + curve * x * v,
        xh=to.xh + curve * x * h,
        xa=to.xa + curve * x * acc,
        yy=to.yy,
        yv=to.yv,
        yh=to.yh,
        ya=to.ya,
        vv=to.vv + curve * v * v,
        vh=to.vh + curve * v * h,
        va=to.va + curve * v * acc,
        hh=to.hh + curve * h * h,
        ha=to.ha + curve * h * acc,
        aa=to.aa + curve * acc * acc,
    )


@kernel
def _add_across(p: Programme, path: Path, k: int, i: int, a: float, other_y: float, to: Stage) -> Stage:
    force, curve = _force(p, path, k, i)
    c, s = path.cosine[k], path.sine[k]
    lead = path.states[k, 2] * p.lead_speed + a * p.lead_acceleration
    y = 1.0 if path.states[k, 1] < other_y else -1.0
    v, h, acc = s * p.lead_speed, c * lead, s * p.lead_acceleration
    return Stage(
        x=to.x,
        y=to.y + force * y,
        v=to.v + force * v,
        h=to.h + force * h,
        a=to.a + force * acc,
        xx=to.xx,
        xv=to.xv,
        xh=to.xh,
        xa=to.xa,
        yy=to.yy + curve,
        yv=to.yv + curve * y * v,
        yh=to.yh + curve * y * h,
        ya=to.ya + curve * y * acc,
        vv=to.vv + curve * v * v,
        vh=to.vh + curve * v * h,
        va=to.va + curve * v * acc,
        hh=to.hh + curve * h * h,
        ha=to.ha + curve * h * acc,
        aa=to.aa + curve * acc * acc,
    )
