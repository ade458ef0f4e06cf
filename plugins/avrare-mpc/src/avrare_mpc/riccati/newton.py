"""Primal-dual interior-point search of plans, one in each lane.

Minimises J(u) + barrier(u, mu) over the inputs u while mu goes to 0 (Nocedal and Wright, Numerical
Optimization, 2nd ed., chapter 19). A tick of the search is one trial:

1. Multipliers stay within orders of magnitude of the central path.
2. Newton direction by the Riccati sweep, with Gauss-Newton curvature and primal-dual bounds; the longest step
   that keeps every bound. After a failed trial both are restored, and the step is shorter.
3. The trial, tested by the merit J + barrier (Armijo); after several that failed, more damping.
4. Newton step of the multipliers.
5. Convergence test at the last mu; before it, a smaller mu.

Lanes are at different ticks of their searches; a lane that is fresh only evaluates its guess.
"""

from __future__ import annotations

from avrare_mpc.riccati.cost import barrier, inside, outside, path_cost
from avrare_mpc.riccati.functions import larger, sine_and_cosine, smaller
from avrare_mpc.riccati.jit import kernel
from avrare_mpc.riccati.lanes import Lanes, Mask, any_of, load, magnitude, peek, select, splat, store
from avrare_mpc.riccati.sweep import sweep
from avrare_mpc.riccati.values import Bounds, Path, Programme, Tuning, Workspace

FOUND, UNFINISHED, STUCK = 0, 1, 2
MARGIN = 0.995
"""Share of the distance to a bound that a step may cover."""
SHRINK = 0.35
"""Factor of the step in the line search."""
TRIALS = 8
"""Steps that are tried before the direction is damped."""
MAX_DAMPING = 1e9
MIN_START_BARRIER = 1e-2
"""Smallest initial barrier parameter, in units of cost."""
AGE, MU, COST, MERIT, DAMPING, STEP, FAILED, SPENT, ENDED, JOB, PENALTY, EXCESS = range(12)
"""Rows of ``Workspace.status``: age is 0 for a fresh lane, 1 once its guess is evaluated, then 2; ended is
1 + FOUND, UNFINISHED or STUCK, else 0; a lane without a job has -1."""


@kernel
def tick(p: Programme, tuning: Tuning, path: Path, trial: Path, work: Workspace, bounds: Bounds) -> None:
    """Try one step of every lane; the trajectories to go on with are those of ``trial``."""
    s = work.status
    age, mu, merit, damping = load(s, AGE), load(s, MU), load(s, MERIT), load(s, DAMPING)
    failed, fresh = load(s, FAILED), age < 0.5
    # 1. multipliers
    _prepare(p, path, work, bounds, mu, age < 1.5)
    # 2. Newton direction and longest step
    slope = sweep(p, path, work, bounds, mu, damping)
    longest, size = _direction(p, path, work, bounds)
    step = select(failed > 0.0, SHRINK * load(s, STEP), longest)
    # 3. trial
    follow(p, path, trial, work, bounds, step, fresh)
    cost = path_cost(p, trial, work)
    mu = select(fresh, larger(tuning.start * cost, MIN_START_BARRIER), mu)
    new = cost + barrier(p, trial, bounds, mu)
    goal = merit + (1e-4 * step * smaller(slope, 0.0) + 1e-10 * magnitude(merit))
    accepted = fresh | (new <= goal)
    moved = accepted & (~fresh)
    failed = select(accepted, 0.0, failed + 1.0)
    damped = failed >= TRIALS
    if any_of((~accepted) & (load(s, JOB) >= 0.0)):
        _keep(p, path, trial, bounds, accepted)
    cost = select(accepted, cost, load(s, COST))
    # 4. multipliers
    _move_multipliers(p, path, work, bounds, mu, moved)
    # 5. convergence, or a smaller barrier
    last = larger(tuning.end * cost, tuning.end)
    ending = mu <= 1.001 * last
    converged = (size * step < tuning.step) | (merit - new < 1e-9 * magnitude(new))
    minimal = moved & ending & converged & (step > 0.1) & (damping <= 1.0)
    reduced = moved & (~ending) & (step > 0.3)
    mu = select(reduced, larger(last, tuning.reduce * mu), mu)
    merit = select(accepted, new, merit)
    if any_of(reduced):
        merit = select(reduced, cost + barrier(p, trial, bounds, mu), merit)
    relaxed = select(damping > 1e-2, 0.1 * damping, 0.0)
    damping = select(damped, larger(10.0 * damping, 1.0), select(moved, relaxed, damping))
    stuck = damped & ((damping > MAX_DAMPING) | (~(slope <= 0.0)))
    spent = load(s, SPENT) + select(moved | damped, 1.0, splat(0.0))
    ended = select(spent >= tuning.iterations, 1.0 + UNFINISHED, splat(0.0))
    ended = select(minimal, 1.0 + FOUND, select(stuck, 1.0 + STUCK, ended))
    _store_progress(s, select(fresh, 1.0, splat(2.0)), mu, cost, merit, damping, step)
    store(s, FAILED, select(damped, 0.0, failed))
    store(s, SPENT, spent)
    store(s, ENDED, ended)


@kernel
def _store_progress(
    s: int, age: Lanes, mu: Lanes, cost: Lanes, merit: Lanes, damping: Lanes, step: Lanes
) -> None:
    store(s, AGE, age)
    store(s, MU, mu)
    store(s, COST, cost)
    store(s, MERIT, merit)
    store(s, DAMPING, damping)
    store(s, STEP, step)


@kernel
def _prepare(p: Programme, path: Path, work: Workspace, bounds: Bounds, mu: Lanes, first: Mask) -> None:
    """Fill in the nearness of the bounds and their slopes; set or limit the multipliers."""
    for k in range(p.steps):
        a, w = load(path.inputs, 2 * k), load(path.inputs, 2 * k + 1)
        low_a, high_a = a + p.acceleration_max, p.acceleration_max - a
        low_w, high_w = w + p.turn_rate_max, p.turn_rate_max - w
        of_a, of_w = low_a * high_a, low_w * high_w
        if bounds.hard > 2:
            lateral = load(path.states, 4 * k + 2) * w
            low, high = p.lateral_max + lateral, p.lateral_max - lateral
            of_lateral = low * high
            inverse = 1.0 / (of_a * of_w * of_lateral)
            _limit_hard(work, 6 * k + 4, mu, first, low, high, of_a * of_w * inverse)
            inverse = inverse * of_lateral
        else:
            inverse = 1.0 / (of_a * of_w)
        _limit_hard(work, 6 * k, mu, first, low_a, high_a, of_w * inverse)
        _limit_hard(work, 6 * k + 2, mu, first, low_w, high_w, of_a * inverse)
        for j in range(bounds.soft):
            _limit_soft(p, path, work, k, j, mu, first)


@kernel
def _limit_hard(
    work: Workspace, row: int, mu: Lanes, first: Mask, low: Lanes, high: Lanes, inverse: Lanes
) -> None:
    """Limit the multipliers of two bounds; ``inverse`` is 1 / (low high)."""
    _limit_multiplier(work, row, mu, first, high * inverse)
    _limit_multiplier(work, row + 1, mu, first, low * inverse)


@kernel
def _limit_multiplier(work: Workspace, row: int, mu: Lanes, first: Mask, near: Lanes) -> None:
    central = mu * near
    limited = larger(smaller(load(work.box, row), 1e8 * central), 1e-8 * central)
    store(work.nearness, row, near)
    store(work.box, row, select(first, central, limited))


@kernel
def _limit_soft(p: Programme, path: Path, work: Workspace, k: int, j: int, mu: Lanes, first: Mask) -> None:
    value, row, penalty = load(path.states, 4 * (k + 1) + j + 1), 6 * k + 2 * j, peek(p.penalty, j)
    low, high = value - peek(p.low, j), peek(p.high, j) - value
    small_low, small_high = load(path.slack, row), load(path.slack, row + 1)
    inside_low, inside_high = inside(low, small_low), inside(high, small_high)
    inverse = 1.0 / (inside_low * inside_high)
    central_low, central_high = mu * inside_high * inverse, mu * inside_low * inverse
    store(work.force, 3 * k + j, central_high - central_low)
    # multipliers
    low_m = _limit(load(work.soft, row), central_low, penalty, first)
    high_m = _limit(load(work.soft, row + 1), central_high, penalty, first)
    store(work.soft, row, low_m)
    store(work.soft, row + 1, high_m)
    # curvature 1 / (inside / multiplier + outside / (penalty - multiplier))
    low_rest, high_rest = penalty - low_m, penalty - high_m
    low_sum = inside_low * low_rest + outside(low, small_low) * low_m
    high_sum = inside_high * high_rest + outside(high, small_high) * high_m
    inverse = 1.0 / (low_sum * high_sum)
    store(work.soft_move, row, high_sum * inverse)
    store(work.soft_move, row + 1, low_sum * inverse)
    store(work.stiffness, row, low_m * low_rest * (high_sum * inverse))
    store(work.stiffness, row + 1, high_m * high_rest * (low_sum * inverse))


@kernel
def _limit(multiplier: Lanes, central: Lanes, penalty: float, first: Mask) -> Lanes:
    most = (1.0 - 1e-9) * penalty
    limited = larger(smaller(multiplier, smaller(1e6 * central, most)), 1e-6 * central)
    return select(first, smaller(central, most), limited)


@kernel
def _direction(p: Programme, path: Path, work: Workspace, bounds: Bounds) -> tuple[Lanes, Lanes]:
    """Fill the linear moves; return the longest step that keeps the bounds, and the size of the move."""
    x, y, v, h, before = splat(0.0), splat(0.0), splat(0.0), splat(0.0), splat(0.0)
    size, pace = splat(0.0), splat(0.0)  # pace: 1 / the step to the nearest bound
    for k in range(p.steps):
        a = load(work.gains, 12 * k) + _feedback(work.gains, 12 * k, x, y, v, h, before)
        w = load(work.gains, 12 * k + 6) + _feedback(work.gains, 12 * k + 6, x, y, v, h, before)
        store(work.move, 3 * k, a)
        store(work.move, 3 * k + 1, w)
        size = larger(magnitude(a) * (1.0 / p.acceleration_max), size)
        size = larger(magnitude(w) * (1.0 / p.turn_rate_max), size)
        pace = _hard_pace(work, 6 * k, a, pace)
        pace = _hard_pace(work, 6 * k + 2, w, pace)
        c, s, speed = load(path.turn, 2 * k), load(path.turn, 2 * k + 1), load(path.states, 4 * k + 2)
        if bounds.hard > 2:
            lateral = v * load(path.inputs, 2 * k + 1) + speed * w
            store(work.move, 3 * k + 2, lateral)
            pace = _hard_pace(work, 6 * k + 4, lateral, pace)
        x = x + p.dt * (c * v - s * speed * h)
        y = y + p.dt * (s * v + c * speed * h)
        v = v + p.dt * a
        h = h + p.dt * w
        before = w
        store(work.drift, 3 * k, y)
        pace = _soft_pace(p, path, k, 0, y, pace)
        if bounds.soft > 1:
            store(work.drift, 3 * k + 1, v)
            store(work.drift, 3 * k + 2, h)
            pace = _soft_pace(p, path, k, 1, v, pace)
            pace = _soft_pace(p, path, k, 2, h, pace)
    return smaller(MARGIN / pace, splat(1.0)), size


@kernel
def _feedback(gains: int, row: int, x: Lanes, y: Lanes, v: Lanes, h: Lanes, before: Lanes) -> Lanes:
    place = load(gains, row + 1) * x + load(gains, row + 2) * y
    motion = load(gains, row + 3) * v + load(gains, row + 4) * h
    return place + (motion + load(gains, row + 5) * before)


@kernel
def _hard_pace(work: Workspace, row: int, move: Lanes, pace: Lanes) -> Lanes:
    pace = larger(-move * load(work.nearness, row), pace)
    return larger(move * load(work.nearness, row + 1), pace)


@kernel
def _soft_pace(p: Programme, path: Path, k: int, j: int, drift: Lanes, pace: Lanes) -> Lanes:
    """Return ``pace``, raised so that the step crosses no soft bound that holds now: it costs a penalty."""
    value = load(path.states, 4 * (k + 1) + j + 1)
    low, high = value - peek(p.low, j), peek(p.high, j) - value
    size_low, size_high = select(low > 0.0, low, splat(1.0)), select(high > 0.0, high, splat(1.0))
    inverse = 1.0 / (size_low * size_high)
    pace = larger(select(low > 0.0, -drift * size_high * inverse, splat(0.0)), pace)
    return larger(select(high > 0.0, drift * size_low * inverse, splat(0.0)), pace)


@kernel
def _move_multipliers(
    p: Programme, path: Path, work: Workspace, bounds: Bounds, mu: Lanes, moved: Mask
) -> None:
    pace = splat(0.0)
    for k in range(p.steps):
        for i in range(bounds.hard):
            pace = _hard_change(work, 6 * k + 2 * i, load(work.move, 3 * k + i), mu, pace)
        for j in range(bounds.soft):
            pace = _soft_change(p, path, work, k, j, mu, pace)
    step = smaller(MARGIN / pace, splat(1.0))
    for k in range(p.steps):
        for i in range(2 * bounds.hard):
            _add_move(work.box, work.box_move, 6 * k + i, step, moved)
        for i in range(2 * bounds.soft):
            _add_move(work.soft, work.soft_move, 6 * k + i, step, moved)


@kernel
def _hard_change(work: Workspace, row: int, move: Lanes, mu: Lanes, pace: Lanes) -> Lanes:
    low, high = load(work.box, row), load(work.box, row + 1)
    near_low, near_high = load(work.nearness, row), load(work.nearness, row + 1)
    change_low = (mu * near_low - low) - low * near_low * move
    change_high = (mu * near_high - high) + high * near_high * move
    store(work.box_move, row, change_low)
    store(work.box_move, row + 1, change_high)
    inverse = 1.0 / (low * high)
    return larger(-change_high * low * inverse, larger(-change_low * high * inverse, pace))


@kernel
def _soft_change(p: Programme, path: Path, work: Workspace, k: int, j: int, mu: Lanes, pace: Lanes) -> Lanes:
    value, row, penalty = load(path.states, 4 * (k + 1) + j + 1), 6 * k + 2 * j, peek(p.penalty, j)
    drift, low, high = load(work.drift, 3 * k + j), load(work.soft, row), load(work.soft, row + 1)
    low_rest, high_rest = penalty - low, penalty - high
    of_low, of_high = low * low_rest, high * high_rest
    low_gap, high_gap = (value - peek(p.low, j)) + drift, (peek(p.high, j) - value) - drift
    change_low = (mu * (low_rest - low) - of_low * low_gap) * load(work.soft_move, row)
    change_high = (mu * (high_rest - high) - of_high * high_gap) * load(work.soft_move, row + 1)
    store(work.soft_move, row, change_low)
    store(work.soft_move, row + 1, change_high)
    inverse = 1.0 / (of_low * of_high)
    for_low, for_high = of_high * inverse, of_low * inverse
    pace = larger(select(change_low < 0.0, -change_low * low_rest, change_low * low) * for_low, pace)
    return larger(select(change_high < 0.0, -change_high * high_rest, change_high * high) * for_high, pace)


@kernel
def _add_move(multipliers: int, moves: int, row: int, step: Lanes, moved: Mask) -> None:
    old = load(multipliers, row)
    store(multipliers, row, select(moved, old + step * load(moves, row), old))


@kernel
def follow(
    p: Programme, path: Path, trial: Path, work: Workspace, bounds: Bounds, step: Lanes, fresh: Mask
) -> None:
    """Simulate ``trial`` with the inputs of ``path``, moved by ``step`` and with feedback on the states.

    du_k = step * constant_k + gain_k (dx_k, du_(k-1)): the feedback of the Riccati sweep compensates for the
    nonlinearity that its linear model ignores. Fresh lanes are not moved.
    """
    x, y, v, h = load(path.states, 0), load(path.states, 1), load(path.states, 2), load(path.states, 3)
    before = splat(0.0)
    for k in range(p.steps):
        c, s = _store_node(trial, k, x, y, v, h)
        old_v = load(path.states, 4 * k + 2)
        dx, dy = x - load(path.states, 4 * k), y - load(path.states, 4 * k + 1)
        dv, dh = v - old_v, h - load(path.states, 4 * k + 3)
        a = step * load(work.gains, 12 * k) + _feedback(work.gains, 12 * k, dx, dy, dv, dh, before)
        w = step * load(work.gains, 12 * k + 6) + _feedback(work.gains, 12 * k + 6, dx, dy, dv, dh, before)
        old_a, old_w = load(path.inputs, 2 * k), load(path.inputs, 2 * k + 1)
        a, w = _move_inside(old_a, a, p.acceleration_max), _move_inside(old_w, w, p.turn_rate_max)
        if bounds.hard > 2:
            w = _keep_lateral(p, old_v * old_w, v, w)
        a, w = select(fresh, old_a, a), select(fresh, old_w, w)
        store(trial.inputs, 2 * k, a)
        store(trial.inputs, 2 * k + 1, w)
        before = w - old_w
        x, y = x + p.dt * v * c, y + p.dt * v * s
        v, h = v + p.dt * a, h + p.dt * w
    _store_node(trial, p.steps, x, y, v, h)


@kernel
def _store_node(path: Path, k: int, x: Lanes, y: Lanes, v: Lanes, h: Lanes) -> tuple[Lanes, Lanes]:
    """Store the state and cosine and sine of its heading; return these."""
    s, c = sine_and_cosine(h)
    store(path.states, 4 * k, x)
    store(path.states, 4 * k + 1, y)
    store(path.states, 4 * k + 2, v)
    store(path.states, 4 * k + 3, h)
    store(path.turn, 2 * k, c)
    store(path.turn, 2 * k + 1, s)
    return c, s


@kernel
def _move_inside(value: Lanes, move: Lanes, limit: float) -> Lanes:
    return value + larger(smaller(move, MARGIN * (limit - value)), -MARGIN * (limit + value))


@kernel
def _keep_lateral(p: Programme, lateral: Lanes, speed: Lanes, turn_rate: Lanes) -> Lanes:
    """Return the turn rate, clipped so that v w covers at most MARGIN of its distance to a bound."""
    inverse = 1.0 / magnitude(speed)
    left = (MARGIN * p.lateral_max + (1.0 - MARGIN) * lateral) * inverse
    right = (MARGIN * p.lateral_max - (1.0 - MARGIN) * lateral) * inverse
    high, low = select(speed < 0.0, right, left), select(speed < 0.0, left, right)
    return larger(smaller(turn_rate, high), -low)


@kernel
def _keep(p: Programme, path: Path, trial: Path, bounds: Bounds, accepted: Mask) -> None:
    """Take back the trials that are not accepted."""
    nodes = p.steps + 1
    _keep_rows(path.inputs, trial.inputs, 2 * p.steps, accepted)
    _keep_rows(path.states, trial.states, 4 * nodes, accepted)
    _keep_rows(path.turn, trial.turn, 2 * nodes, accepted)
    _keep_rows(path.lane, trial.lane, 2 * nodes, accepted)
    _keep_rows(path.push, trial.push, 4 * p.vehicles * nodes, accepted)
    _keep_rows(path.slack, trial.slack, 6 * p.steps, accepted)


@kernel
def _keep_rows(old: int, new: int, rows: int, accepted: Mask) -> None:
    for row in range(rows):
        store(new, row, select(accepted, load(new, row), load(old, row)))
