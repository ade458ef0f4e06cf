"""Primal-dual interior-point search of one particle's plan.

Minimises J(u) + barrier(u, mu) over the inputs u while mu goes to 0 (Nocedal and Wright, Numerical
Optimization, 2nd ed., chapter 19). An iteration:

1. Newton direction by the Riccati sweep, with Gauss-Newton curvature and primal-dual bounds.
2. Fraction-to-boundary rule: longest step that keeps every bound.
3. Backtracking line search on the merit J + barrier (Armijo); without a step, more damping and back to 1.
4. Newton step of the multipliers.
5. Convergence test at the last mu; before it, a smaller mu.
6. Multipliers stay within orders of magnitude of the central path.
"""

from __future__ import annotations

import math

from avrare_mpc.riccati.cost import barrier, path_cost
from avrare_mpc.riccati.jit import kernel
from avrare_mpc.riccati.sweep import sweep
from avrare_mpc.riccati.values import Bounds, Floats, Others, Path, Programme, Tuning, Workspace

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


@kernel
def search(
    p: Programme, tuning: Tuning, path: Path, trial: Path, work: Workspace, others: Others, bounds: Bounds
) -> tuple[Path, float, int, int]:
    """Improve ``path``, given by its first state and its inputs, until it is a local minimum.

    Returns:
        The last trajectory, its cost, FOUND, UNFINISHED or STUCK, and the number of iterations.
    """
    simulate(p, path)
    cost = path_cost(p, path, others)
    mu = max(tuning.start * cost, MIN_START_BARRIER)
    merit = cost + barrier(p, path, bounds, mu)
    _start_multipliers(p, path, work, bounds, mu)
    damping = 0.0
    for iteration in range(1, tuning.iterations + 1):
        # 1. Newton direction
        slope = sweep(p, path, work, others, bounds, mu, damping)
        # 2. longest step
        longest, size = _direction(p, path, work, bounds)
        # 3. line search
        step, new_cost, new_merit = _line_search(
            p, path, trial, work, others, bounds, mu, merit, slope, longest
        )
        if step == 0.0:
            damping = max(10.0 * damping, 1.0)
            if damping > MAX_DAMPING or not slope <= 0.0:
                return path, cost, STUCK, iteration
            continue
        # 4. multipliers
        _move_multipliers(p, path, work, bounds, mu)
        gain, cost, merit = merit - new_merit, new_cost, new_merit
        path, trial = trial, path
        # 5. convergence, or a smaller barrier
        last = max(tuning.end * cost, tuning.end)
        if mu <= 1.001 * last:
            converged = size * step < tuning.step or gain < 1e-9 * abs(merit)
            if converged and step > 0.1 and damping <= 1.0:
                return path, cost, FOUND, iteration
        elif step > 0.3:
            mu = max(last, tuning.reduce * mu)
            merit = cost + barrier(p, path, bounds, mu)
        damping = 0.1 * damping if damping > 1e-2 else 0.0
        # 6. orders of magnitude around the central path mu / gap
        _limit_multipliers(p, path, work, bounds, mu)
    return path, cost, UNFINISHED, tuning.iterations


@kernel
def _line_search(
    p: Programme, path: Path, trial: Path, work: Workspace, others: Others, bounds: Bounds, mu: float,
    merit: float, slope: float, longest: float,
) -> tuple[float, float, float]:  # fmt: skip
    step = longest
    for _ in range(TRIALS):
        follow(p, path, trial, work.gains, bounds, step)
        cost = path_cost(p, trial, others)
        new = cost + barrier(p, trial, bounds, mu)
        if new <= merit + 1e-4 * step * min(slope, 0.0) + 1e-10 * abs(merit):
            return step, cost, new
        step *= SHRINK
    return 0.0, 0.0, merit  # no step was accepted


@kernel
def _direction(p: Programme, path: Path, work: Workspace, bounds: Bounds) -> tuple[float, float]:
    """Fill the linear moves; return the longest step that keeps the bounds, and the size of the move."""
    x = y = v = h = before = size = 0.0
    longest = 1.0
    for k in range(len(path.inputs)):
        gain = work.gains[k]
        a = gain[0] + gain[1] * x + gain[2] * y + gain[3] * v + gain[4] * h + gain[5] * before
        w = gain[6] + gain[7] * x + gain[8] * y + gain[9] * v + gain[10] * h + gain[11] * before
        work.move[k, 0], work.move[k, 1] = a, w
        work.move[k, 2] = v * path.inputs[k, 1] + path.states[k, 2] * w
        size = max(size, abs(a) / p.acceleration_max, abs(w) / p.turn_rate_max)
        c, s, speed = path.cosine[k], path.sine[k], path.states[k, 2]
        x += p.dt * (c * v - s * speed * h)
        y += p.dt * (s * v + c * speed * h)
        v += p.dt * a
        h += p.dt * w
        before = w
        work.drift[k, 0], work.drift[k, 1], work.drift[k, 2] = y, v, h
        for i in range(4):
            longest = _shorten(longest, _gap(p, path, k, i), _toward(work.move, k, i))
        if bounds.hard > 4:
            longest = _shorten(longest, _lateral_gap(p, path, k, 1.0), work.move[k, 2])
            longest = _shorten(longest, _lateral_gap(p, path, k, -1.0), -work.move[k, 2])
        for i in range(2 * bounds.soft):
            gap = path.inside[k, i] - path.outside[k, i]
            if gap > 0.0:  # a kept soft bound stays kept: crossing it would cost the penalty at once
                longest = _shorten(longest, gap, _toward(work.drift, k, i))
    return longest, size


@kernel
def _toward(moves: Floats, k: int, i: int) -> float:
    """Return the change of the distance from bound i: lower bounds are even, upper ones odd."""
    move: float = moves[k, i // 2]
    return move if i % 2 == 0 else -move


@kernel
def _shorten(step: float, gap: float, change: float) -> float:
    return min(step, -MARGIN * gap / change) if change < 0.0 else step


@kernel
def _gap(p: Programme, path: Path, k: int, i: int) -> float:
    limit = p.acceleration_max if i < 2 else p.turn_rate_max
    value: float = path.inputs[k, i // 2]
    return limit + value if i % 2 == 0 else limit - value


@kernel
def _lateral_gap(p: Programme, path: Path, k: int, sign: float) -> float:
    gap: float = p.lateral_max + sign * path.states[k, 2] * path.inputs[k, 1]
    return gap


@kernel
def _start_multipliers(p: Programme, path: Path, work: Workspace, bounds: Bounds, mu: float) -> None:
    for k in range(len(path.inputs)):
        for i in range(4):
            work.box[k, i] = mu / _gap(p, path, k, i)
        if bounds.hard > 4:
            work.box[k, 4] = mu / _lateral_gap(p, path, k, 1.0)
            work.box[k, 5] = mu / _lateral_gap(p, path, k, -1.0)
        for i in range(2 * bounds.soft):
            work.soft[k, i] = min(mu / path.inside[k, i], (1.0 - 1e-9) * p.penalty[i // 2])


@kernel
def _move_multipliers(p: Programme, path: Path, work: Workspace, bounds: Bounds, mu: float) -> None:
    step = 1.0
    for k in range(len(path.inputs)):
        for i in range(4):
            multiplier = work.box[k, i]
            change = _hard_move(multiplier, _gap(p, path, k, i), _toward(work.move, k, i), mu)
            work.box_move[k, i] = change
            step = _shorten(step, multiplier, change)
        if bounds.hard > 4:
            low, high = _lateral_gap(p, path, k, 1.0), _lateral_gap(p, path, k, -1.0)
            work.box_move[k, 4] = _hard_move(work.box[k, 4], low, work.move[k, 2], mu)
            work.box_move[k, 5] = _hard_move(work.box[k, 5], high, -work.move[k, 2], mu)
            step = _shorten(step, work.box[k, 4], work.box_move[k, 4])
            step = _shorten(step, work.box[k, 5], work.box_move[k, 5])
        for i in range(2 * bounds.soft):
            change, rest = _soft_move(p, path, work, k, i, mu)
            work.soft_move[k, i] = change
            step = _shorten(_shorten(step, work.soft[k, i], change), rest, -change)
    for k in range(len(path.inputs)):
        for i in range(4):
            work.box[k, i] += step * work.box_move[k, i]
        if bounds.hard > 4:
            work.box[k, 4] += step * work.box_move[k, 4]
            work.box[k, 5] += step * work.box_move[k, 5]
        for i in range(2 * bounds.soft):
            work.soft[k, i] += step * work.soft_move[k, i]


@kernel
def _hard_move(multiplier: float, gap: float, toward: float, mu: float) -> float:
    return mu / gap - multiplier - multiplier / gap * toward


@kernel
def _central(multiplier: float, central: float) -> float:
    return max(min(multiplier, 1e8 * central), 1e-8 * central)


@kernel
def _soft_move(p: Programme, path: Path, work: Workspace, k: int, i: int, mu: float) -> tuple[float, float]:
    """Return the change of a soft bound's multiplier, and its distance from the penalty, its upper bound."""
    multiplier = work.soft[k, i]
    rest = p.penalty[i // 2] - multiplier
    inside, outside = path.inside[k, i], path.outside[k, i]
    residual = mu / multiplier - mu / rest - (inside - outside) - _toward(work.drift, k, i)
    return residual / (inside / multiplier + outside / rest), rest


@kernel
def _limit_multipliers(p: Programme, path: Path, work: Workspace, bounds: Bounds, mu: float) -> None:
    for k in range(len(path.inputs)):
        for i in range(4):
            work.box[k, i] = _central(work.box[k, i], mu / _gap(p, path, k, i))
        if bounds.hard > 4:
            work.box[k, 4] = _central(work.box[k, 4], mu / _lateral_gap(p, path, k, 1.0))
            work.box[k, 5] = _central(work.box[k, 5], mu / _lateral_gap(p, path, k, -1.0))
        for i in range(2 * bounds.soft):
            central = mu / path.inside[k, i]
            highest = min(1e6 * central, (1.0 - 1e-9) * p.penalty[i // 2])
            work.soft[k, i] = max(min(work.soft[k, i], highest), 1e-6 * central)


@kernel
def simulate(p: Programme, path: Path) -> None:
    """Compute the states of ``path`` from its first state and its inputs."""
    for k in range(len(path.inputs)):
        _advance(p, path, k)
    _update_heading(path, len(path.inputs))


@kernel
def follow(p: Programme, path: Path, trial: Path, gains: Floats, bounds: Bounds, step: float) -> None:
    """Simulate ``trial`` with the inputs of ``path``, moved by ``step`` and with feedback on the states.

    du_k = step * constant_k + gain_k (dx_k, du_(k-1)): the feedback of the Riccati sweep compensates for the
    nonlinearity that its linear model ignores.
    """
    for i in range(4):
        trial.states[0, i] = path.states[0, i]
    before = 0.0
    for k in range(len(path.inputs)):
        x, y = trial.states[k, 0] - path.states[k, 0], trial.states[k, 1] - path.states[k, 1]
        v, h = trial.states[k, 2] - path.states[k, 2], trial.states[k, 3] - path.states[k, 3]
        gain = gains[k]
        a = step * gain[0] + gain[1] * x + gain[2] * y + gain[3] * v + gain[4] * h + gain[5] * before
        w = step * gain[6] + gain[7] * x + gain[8] * y + gain[9] * v + gain[10] * h + gain[11] * before
        trial.inputs[k, 0] = _move_inside(path.inputs[k, 0], a, p.acceleration_max)
        trial.inputs[k, 1] = _move_inside(path.inputs[k, 1], w, p.turn_rate_max)
        if bounds.hard > 4:
            trial.inputs[k, 1] = _keep_lateral(p, path, trial, k)
        before = trial.inputs[k, 1] - path.inputs[k, 1]
        _advance(p, trial, k)
    _update_heading(trial, len(path.inputs))


@kernel
def _move_inside(value: float, move: float, limit: float) -> float:
    return value + max(min(move, MARGIN * (limit - value)), -MARGIN * (limit + value))


@kernel
def _keep_lateral(p: Programme, path: Path, trial: Path, k: int) -> float:
    """Return the trial's turn rate, clipped so that v w covers at most MARGIN of its distance to a bound."""
    lateral, speed = path.states[k, 2] * path.inputs[k, 1], trial.states[k, 2]
    high = (MARGIN * p.lateral_max + (1.0 - MARGIN) * lateral) / abs(speed)
    low = (MARGIN * p.lateral_max - (1.0 - MARGIN) * lateral) / abs(speed)
    if speed < 0.0:
        low, high = high, low
    turn_rate: float = max(min(trial.inputs[k, 1], high), -low)
    return turn_rate


@kernel
def _update_heading(path: Path, k: int) -> None:
    path.cosine[k], path.sine[k] = math.cos(path.states[k, 3]), math.sin(path.states[k, 3])


@kernel
def _advance(p: Programme, path: Path, k: int) -> None:
    _update_heading(path, k)
    v = path.states[k, 2]
    path.states[k + 1, 0] = path.states[k, 0] + p.dt * v * path.cosine[k]
    path.states[k + 1, 1] = path.states[k, 1] + p.dt * v * path.sine[k]
    path.states[k + 1, 2] = v + p.dt * path.inputs[k, 0]
    path.states[k + 1, 3] = path.states[k, 3] + p.dt * path.inputs[k, 1]
