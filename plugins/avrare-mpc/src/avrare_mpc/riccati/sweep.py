"""Riccati recursion over the stages: the Newton direction of all inputs.

With state s = (x, y, v, h, previous w), inputs u = (a, w), dynamics ds+ = A ds + B du and stage cost (l_s,
l_u, L_ss, L_su, L_uu), go from the last node backwards with the quadratic model V of the cost to go:

1. Add the soft bounds of y, v, h at the next node to V.
2. Expand the stage: Q_s = l_s + A^T V_s, Q_u = l_u + B^T V_s, Q_ss = L_ss + A^T V_ss A,
   Q_su = L_su + A^T V_ss B, Q_uu = L_uu + B^T V_ss B.
3. Minimise over du: du = k + K ds with k = -Q_uu^-1 Q_u, K = -Q_uu^-1 Q_su^T.
4. Update: V_s = Q_s + Q_su k, V_ss = Q_ss + Q_su K; the slope of the cost along k is Q_u^T k.

The products are written out, because most entries of A, B and L are 0.
"""

from __future__ import annotations

from typing import NamedTuple

from avrare_mpc.riccati.cost import Stage, stage_model
from avrare_mpc.riccati.jit import kernel
from avrare_mpc.riccati.lanes import Lanes, Memory, load, splat, store
from avrare_mpc.riccati.values import LAST, Bounds, Path, Programme, Workspace


class Value(NamedTuple):
    """Gradient and Hessian V of the cost to go by x, y, v, h, previous w."""

    grad_x: Lanes
    grad_y: Lanes
    grad_v: Lanes
    grad_h: Lanes
    grad_w: Lanes
    xx: Lanes
    xy: Lanes
    xv: Lanes
    xh: Lanes
    xw: Lanes
    yy: Lanes
    yv: Lanes
    yh: Lanes
    yw: Lanes
    vv: Lanes
    vh: Lanes
    vw: Lanes
    hh: Lanes
    hw: Lanes
    ww: Lanes


class Expansion(NamedTuple):
    """Gradient and Hessian Q of stage and cost to go by x, y, v, h and the inputs a and w."""

    grad_x: Lanes
    grad_y: Lanes
    grad_v: Lanes
    grad_h: Lanes
    grad_a: Lanes
    grad_w: Lanes
    xx: Lanes
    xy: Lanes
    xv: Lanes
    xh: Lanes
    xa: Lanes
    xw: Lanes
    yy: Lanes
    yv: Lanes
    yh: Lanes
    ya: Lanes
    yw: Lanes
    vv: Lanes
    vh: Lanes
    va: Lanes
    vw: Lanes
    hh: Lanes
    ha: Lanes
    hw: Lanes
    aa: Lanes
    aw: Lanes
    ww: Lanes


class InputModel(NamedTuple):
    """Gradient and Hessian of weights and hard bounds of a stage, and of the change of the turn rate.

    Attributes:
        change: Second derivative of the cost of the change.
        lag: First derivative of the cost of the change.
    """

    grad_v: Lanes
    grad_a: Lanes
    grad_w: Lanes
    vv: Lanes
    vw: Lanes
    aa: Lanes
    ww: Lanes
    change: Lanes
    lag: Lanes


@kernel
def sweep(p: Programme, path: Path, work: Workspace, bounds: Bounds, mu: Lanes, damping: Lanes) -> Lanes:
    """Compute the gains of every stage into ``work.gains``.

    Args:
        p: The programme.
        path: The current trajectories.
        work: Memory; its multipliers are read.
        bounds: Bounds that count.
        mu: Barrier parameter.
        damping: Added to Q_uu, in units of the inputs' bounds.

    Returns:
        Slope of the barrier cost along the direction.
    """
    steps, none = p.steps, splat(0.0)
    model = stage_model(p, path, steps, none)
    before = load(path.inputs, 2 * steps - 1)
    rest = 2.0 * p.final_turn_rate
    value = Value(
        model.grad_x, model.grad_y, model.grad_v, model.grad_h, rest * before,
        model.xx, none, model.xv, model.xh, none,
        model.yy, model.yv, model.yh, none,
        model.vv, model.vh, none,
        model.hh, none,
        splat(rest),
    )  # fmt: skip
    slope = splat(0.0)
    for k in range(steps - 1, -1, -1):
        # 1. soft bounds
        value = _add_bounds(work, k, bounds, value)
        # 2. expansion
        model = stage_model(p, path, k, load(path.inputs, 2 * k))
        inputs = _input_model(p, path, work, k, bounds, mu, damping)
        expansion = _expand(p, path, k, value, model, inputs)
        # 3. and 4. gains and cost to go
        value, along = _minimise(expansion, inputs, work.gains, k)
        slope = slope + along
    return slope


@kernel
def _add_bounds(work: Workspace, k: int, bounds: Bounds, to: Value) -> Value:
    gy, hy = load(work.force, 3 * k), load(work.stiffness, 6 * k) + load(work.stiffness, 6 * k + 1)
    gv, hv, gh, hh = splat(0.0), splat(0.0), splat(0.0), splat(0.0)
    if bounds.soft > 1:
        gv, hv = (
            load(work.force, 3 * k + 1),
            load(work.stiffness, 6 * k + 2) + load(work.stiffness, 6 * k + 3),
        )
        gh, hh = (
            load(work.force, 3 * k + 2),
            load(work.stiffness, 6 * k + 4) + load(work.stiffness, 6 * k + 5),
        )
    return Value(
        to.grad_x, to.grad_y + gy, to.grad_v + gv, to.grad_h + gh, to.grad_w,
        to.xx, to.xy, to.xv, to.xh, to.xw,
        to.yy + hy, to.yv, to.yh, to.yw,
        to.vv + hv, to.vh, to.vw,
        to.hh + hh, to.hw,
        to.ww,
    )  # fmt: skip


@kernel
def _expand(p: Programme, path: Path, k: int, to: Value, at: Stage, inputs: InputModel) -> Expansion:
    dt, c, s = p.dt, load(path.turn, 2 * k), load(path.turn, 2 * k + 1)
    v = load(path.states, 4 * k + 2)
    xv, xh, yv, yh = dt * c, -dt * s * v, dt * s, dt * c * v
    v_x, v_y = to.xv + xv * to.xx + yv * to.xy, to.yv + xv * to.xy + yv * to.yy
    v_v = to.vv + xv * to.xv + yv * to.yv
    h_x, h_y = to.xh + xh * to.xx + yh * to.xy, to.yh + xh * to.xy + yh * to.yy
    h_v, h_h = to.vh + xh * to.xv + yh * to.yv, to.hh + xh * to.xh + yh * to.yh
    w_x, w_y, w_v = dt * to.xh + to.xw, dt * to.yh + to.yw, dt * to.vh + to.vw
    w_h, w_w = dt * to.hh + to.hw, dt * to.hw + to.ww
    return Expansion(
        grad_x=at.grad_x + to.grad_x,
        grad_y=at.grad_y + to.grad_y,
        grad_v=at.grad_v + to.grad_v + xv * to.grad_x + yv * to.grad_y + inputs.grad_v,
        grad_h=at.grad_h + to.grad_h + xh * to.grad_x + yh * to.grad_y,
        grad_a=at.grad_a + dt * to.grad_v + inputs.grad_a,
        grad_w=dt * to.grad_h + to.grad_w + inputs.grad_w,
        xx=at.xx + to.xx,
        xy=to.xy,
        xv=at.xv + v_x,
        xh=at.xh + h_x,
        xa=at.xa + dt * to.xv,
        xw=w_x,
        yy=at.yy + to.yy,
        yv=at.yv + v_y,
        yh=at.yh + h_y,
        ya=at.ya + dt * to.yv,
        yw=w_y,
        vv=at.vv + v_v + xv * v_x + yv * v_y + inputs.vv,
        vh=at.vh + h_v + xv * h_x + yv * h_y,
        va=at.va + dt * v_v,
        vw=w_v + xv * w_x + yv * w_y + inputs.vw,
        hh=at.hh + h_h + xh * h_x + yh * h_y,
        ha=at.ha + dt * h_v,
        hw=w_h + xh * w_x + yh * w_y,
        aa=at.aa + dt * dt * to.vv + inputs.aa,
        aw=dt * w_v,
        ww=dt * w_h + w_w + inputs.ww,
    )


@kernel
def _input_model(
    p: Programme, path: Path, work: Workspace, k: int, bounds: Bounds, mu: Lanes, damping: Lanes
) -> InputModel:
    w = load(path.inputs, 2 * k + 1)
    if k > 0:
        change = splat(2.0 * p.turn_rate_change_weight)
        lag = change * (w - load(path.inputs, 2 * k - 1))
    else:
        change = splat(2.0 * p.start_change_weight)
        lag = change * (w - load(work.status, LAST))
    push_a, stiff_a = _hard_bound(work, 6 * k, mu)
    push_w, stiff_w = _hard_bound(work, 6 * k + 2, mu)
    speed, push, stiff = splat(0.0), splat(0.0), splat(0.0)
    if bounds.hard > 2:
        speed = load(path.states, 4 * k + 2)
        push, stiff = _hard_bound(work, 6 * k + 4, mu)
    rate = 2.0 * p.turn_rate_weight
    return InputModel(
        grad_v=push * w,
        grad_a=push_a,
        grad_w=rate * w + lag + push_w + push * speed,
        vv=stiff * w * w,
        vw=stiff * w * speed,
        aa=stiff_a + damping * (1.0 / (p.acceleration_max * p.acceleration_max)),
        ww=(rate + change + stiff_w + damping * (1.0 / (p.turn_rate_max * p.turn_rate_max)))
        + stiff * speed * speed,
        change=change,
        lag=lag,
    )


@kernel
def _hard_bound(work: Workspace, row: int, mu: Lanes) -> tuple[Lanes, Lanes]:
    """Return slope and curvature of the barriers of a lower bound and of the upper one behind it."""
    low, high = load(work.nearness, row), load(work.nearness, row + 1)
    return mu * high - mu * low, load(work.box, row) * low + load(work.box, row + 1) * high


@kernel
def _minimise(q: Expansion, inputs: InputModel, gains: Memory, k: int) -> tuple[Value, Lanes]:
    scale = 1.0 / (q.aa * q.ww - q.aw * q.aw)
    aa, aw, ww = q.ww * scale, -q.aw * scale, q.aa * scale
    a, w = -(aa * q.grad_a + aw * q.grad_w), -(aw * q.grad_a + ww * q.grad_w)
    ax, wx = -(aa * q.xa + aw * q.xw), -(aw * q.xa + ww * q.xw)
    ay, wy = -(aa * q.ya + aw * q.yw), -(aw * q.ya + ww * q.yw)
    av, wv = -(aa * q.va + aw * q.vw), -(aw * q.va + ww * q.vw)
    ah, wh = -(aa * q.ha + aw * q.hw), -(aw * q.ha + ww * q.hw)
    ap, wp = aw * inputs.change, ww * inputs.change
    _store_gains(gains, 12 * k, a, ax, ay, av, ah, ap)
    _store_gains(gains, 12 * k + 6, w, wx, wy, wv, wh, wp)
    value = Value(
        q.grad_x + q.xa * a + q.xw * w,
        q.grad_y + q.ya * a + q.yw * w,
        q.grad_v + q.va * a + q.vw * w,
        q.grad_h + q.ha * a + q.hw * w,
        -inputs.lag - inputs.change * w,
        q.xx + q.xa * ax + q.xw * wx,
        q.xy + q.xa * ay + q.xw * wy,
        q.xv + q.xa * av + q.xw * wv,
        q.xh + q.xa * ah + q.xw * wh,
        q.xa * ap + q.xw * wp,
        q.yy + q.ya * ay + q.yw * wy,
        q.yv + q.ya * av + q.yw * wv,
        q.yh + q.ya * ah + q.yw * wh,
        q.ya * ap + q.yw * wp,
        q.vv + q.va * av + q.vw * wv,
        q.vh + q.va * ah + q.vw * wh,
        q.va * ap + q.vw * wp,
        q.hh + q.ha * ah + q.hw * wh,
        q.ha * ap + q.hw * wp,
        inputs.change - inputs.change * wp,
    )
    return value, q.grad_a * a + q.grad_w * w


@kernel
def _store_gains(
    gains: Memory, row: int, constant: Lanes, x: Lanes, y: Lanes, v: Lanes, h: Lanes, before: Lanes
) -> None:
    store(gains, row, constant)
    store(gains, row + 1, x)
    store(gains, row + 2, y)
    store(gains, row + 3, v)
    store(gains, row + 4, h)
    store(gains, row + 5, before)
