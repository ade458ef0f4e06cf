"""Primal-dual interior-point search of one particle's plan.

Newton directions come from the Riccati sweep, lengths from a line search on the barrier cost.
"""

from __future__ import annotations

from avrare_mpc.riccati.cost import barrier, drive_cost
from avrare_mpc.riccati.drive import MARGIN, drive, follow
from avrare_mpc.riccati.jit import kernel
from avrare_mpc.riccati.sweep import sweep
from avrare_mpc.riccati.values import Floats, Others, Path, Programme, Tuning, Workspace

FOUND, UNFINISHED, STUCK = 0, 1, 2
SHRINK = 0.35
"""Factor of a step that was too long."""
TRIALS = 8
"""Steps that are tried before the direction is damped."""
LARGEST_DAMPING = 1e9
LEAST_BARRIER = 1e-2
"""Where the barrier starts at least, in units of cost."""


@kernel
def search(
    p: Programme, tuning: Tuning, path: Path, trial: Path, work: Workspace, others: Others, bounds: int
) -> tuple[Path, float, int, int]:
    """Improve ``path``, given by its first state and its inputs, until it is a minimum.

    Returns:
        The last drive, its cost, FOUND, UNFINISHED or STUCK, and the number of iterations.
    """
    drive(p, path)
    cost = drive_cost(p, path, others)
    mu = max(tuning.start * cost, LEAST_BARRIER)
    merit = cost + barrier(p, path, bounds, mu)
    _start_multipliers(p, path, work, bounds, mu)
    damping = 0.0
    for iteration in range(1, tuning.iterations + 1):
        slope = sweep(p, path, work, others, bounds, mu, damping)
        longest, size = _direction(p, path, work, bounds)
        step, new_cost, new_merit = _line_search(
            p, path, trial, work, others, bounds, mu, merit, slope, longest
        )
        if step == 0.0:
            damping = max(10.0 * damping, 1.0)
            if damping > LARGEST_DAMPING or not slope <= 0.0:
                return path, cost, STUCK, iteration
            continue
        _move_multipliers(p, path, work, bounds, mu)
        gain, cost, merit = merit - new_merit, new_cost, new_merit
        path, trial = trial, path
        last = max(tuning.end * cost, tuning.end)
        if mu <= 1.001 * last:
            arrived = size * step < tuning.step or gain < 1e-9 * abs(merit)
            if arrived and step > 0.1 and damping <= 1.0:
                return path, cost, FOUND, iteration
        elif step > 0.3:
            mu = max(last, tuning.reduce * mu)
            merit = cost + barrier(p, path, bounds, mu)
        damping = 0.1 * damping if damping > 1e-2 else 0.0
        _limit_multipliers(p, path, work, bounds, mu)
    return path, cost, UNFINISHED, tuning.iterations


@kernel
def _line_search(
    p: Programme,
    path: Path,
    trial: Path,
    work: Workspace,
    others: Others,
    bounds: int,
    mu: float,
    merit: float,
    slope: float,
    longest: float,
) -> tuple[float, float, float]:
    """Shorten the step until it is good: step, cost and merit of ``trial``; step 0 where none was."""
    step = longest
    for _ in range(TRIALS):
        follow(p, path, trial, work.gains, step)
        cost = drive_cost(p, trial, others)
        new = cost + barrier(p, trial, bounds, mu)
        if new <= merit + 1e-4 * step * min(slope, 0.0) + 1e-10 * abs(merit):
            return step, cost, new
        step *= SHRINK
    return 0.0, 0.0, merit


@kernel
def _direction(p: Programme, path: Path, work: Workspace, bounds: int) -> tuple[float, float]:
    """Fill the linear moves; returns the longest step that keeps the bounds, and the size of the move."""
    x = y = v = h = before = size = 0.0
    longest = 1.0
    for k in range(len(path.inputs)):
        gain = work.gains[k]
        a = gain[0] + gain[1] * x + gain[2] * y + gain[3] * v + gain[4] * h + gain[5] * before
        w = gain[6] + gain[7] * x + gain[8] * y + gain[9] * v + gain[10] * h + gain[11] * before
        work.move[k, 0], work.move[k, 1] = a, w
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
        for i in range(2 * bounds):
            gap = path.inside[k, i] - path.outside[k, i]
            if gap > 0.0:  # a bound that is kept stays kept: crossing it would cost the penalty at once
                longest = _shorten(longest, gap, _toward(work.drift, k, i))
    return longest, size


@kernel
def _toward(moves: Floats, k: int, i: int) -> float:
    """How the distance from bound number i changes: lower bounds are even, upper ones odd."""
    move: float = moves[k, i // 2]
    return move if i % 2 == 0 else -move


@kernel
def _shorten(step: float, gap: float, change: float) -> float:
    return min(step, -MARGIN * gap / change) if change < 0.0 else step


@kernel
def _gap(p: Programme, path: Path, k: int, i: int) -> float:
    """Distance of an input from its bound number i: low a, high a, low w, high w."""
    limit = p.acceleration_max if i < 2 else p.turn_rate_max
    value: float = path.inputs[k, i // 2]
    return limit + value if i % 2 == 0 else limit - value


@kernel
def _start_multipliers(p: Programme, path: Path, work: Workspace, bounds: int, mu: float) -> None:
    for k in range(len(path.inputs)):
        for i in range(4):
            work.box[k, i] = mu / _gap(p, path, k, i)
        for i in range(2 * bounds):
            work.soft[k, i] = min(mu / path.inside[k, i], (1.0 - 1e-9) * p.penalty[i // 2])


@kernel
def _move_multipliers(p: Programme, path: Path, work: Workspace, bounds: int, mu: float) -> None:
    """Newton step of the multipliers, as far as they stay inside their own bounds."""
    step = 1.0
    for k in range(len(path.inputs)):
        for i in range(4):
            gap, multiplier = _gap(p, path, k, i), work.box[k, i]
            change = mu / gap - multiplier - multiplier / gap * _toward(work.move, k, i)
            work.box_move[k, i] = change
            step = _shorten(step, multiplier, change)
        for i in range(2 * bounds):
            change, rest = _soft_move(p, path, work, k, i, mu)
            work.soft_move[k, i] = change
            step = _shorten(_shorten(step, work.soft[k, i], change), rest, -change)
    for k in range(len(path.inputs)):
        for i in range(4):
            work.box[k, i] += step * work.box_move[k, i]
        for i in range(2 * bounds):
            work.soft[k, i] += step * work.soft_move[k, i]


@kernel
def _soft_move(p: Programme, path: Path, work: Workspace, k: int, i: int, mu: float) -> tuple[float, float]:
    """Change of a soft bound's multiplier, and what is left to the penalty, its largest value."""
    multiplier = work.soft[k, i]
    rest = p.penalty[i // 2] - multiplier
    inside, outside = path.inside[k, i], path.outside[k, i]
    residual = mu / multiplier - mu / rest - (inside - outside) - _toward(work.drift, k, i)
    return residual / (inside / multiplier + outside / rest), rest


@kernel
def _limit_multipliers(p: Programme, path: Path, work: Workspace, bounds: int, mu: float) -> None:
    """Keep the multipliers within orders of magnitude of what the barrier says."""
    for k in range(len(path.inputs)):
        for i in range(4):
            central = mu / _gap(p, path, k, i)
            work.box[k, i] = max(min(work.box[k, i], 1e8 * central), 1e-8 * central)
        for i in range(2 * bounds):
            central = mu / path.inside[k, i]
            highest = min(1e6 * central, (1.0 - 1e-9) * p.penalty[i // 2])
            work.soft[k, i] = max(min(work.soft[k, i], highest), 1e-6 * central)
