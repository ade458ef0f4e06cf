"""Entry kernel: many searches, the lanes refilled as they end."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from avrare_mpc.riccati.cost import penalties
from avrare_mpc.riccati.jit import entry, kernel, sources_digest
from avrare_mpc.riccati.lanes import WIDTH, Memory, any_of, load, peek, poke, splat, store
from avrare_mpc.riccati.newton import AGE, COST, DAMPING, ENDED, EXCESS, FAILED, JOB, PENALTY, SPENT, tick
from avrare_mpc.riccati.values import LAST, Bounds, Path, Programme, Tuning, Workspace

GUESS_SHARE = 0.98
"""Share of the input bounds that a guess may use."""


class Jobs(NamedTuple):
    """M searches of N programmes.

    Attributes:
        start: (N, 5) x, y, speed, heading now, and the last turn rate.
        other_x: (N, V, H + 1) predicted positions [m].
        other_y: (N, V, H + 1) predicted positions [m].
        rows: (M,) indices of the programmes.
        guesses: (M, H, 2) inputs.
    """

    start: Memory
    other_x: Memory
    other_y: Memory
    rows: Memory
    guesses: Memory


class Answer(NamedTuple):
    """Results of M searches.

    Attributes:
        states: (M, H + 1, 4) x, y, speed, heading.
        inputs: (M, H, 2) acceleration, turn rate.
        cost: (M,) with the lateral penalty.
        excess: (M,) largest violation of the bounds of speed and heading.
        status: (M,) FOUND, UNFINISHED or STUCK.
        iterations: (M,) number of iterations.
    """

    states: Memory
    inputs: Memory
    cost: Memory
    excess: Memory
    status: Memory
    iterations: Memory


@kernel
def _clip(value: float, limit: float) -> float:
    return max(min(value, limit), -limit)


@kernel
def _begin(
    p: Programme, bounds: Bounds, path: Path, work: Workspace, jobs: Jobs, job: int, lane: int
) -> None:
    """Put a job into a lane."""
    row, nodes, speed = int(peek(jobs.rows, job)), p.steps + 1, 0.0
    for i in range(4):
        poke(path.states, i * WIDTH + lane, peek(jobs.start, 5 * row + i))
    poke(work.status, LAST * WIDTH + lane, peek(jobs.start, 5 * row + 4))
    speed = peek(jobs.start, 5 * row + 2)
    for k in range(p.steps):
        place = 2 * (p.steps * job + k)
        a = _clip(peek(jobs.guesses, place), GUESS_SHARE * p.acceleration_max)
        w = _clip(peek(jobs.guesses, place + 1), GUESS_SHARE * p.turn_rate_max)
        if bounds.hard > 2:
            w = _clip(w, GUESS_SHARE * p.lateral_max / max(abs(speed), 1e-300))
        speed += p.dt * a
        poke(path.inputs, 2 * k * WIDTH + lane, a)
        poke(path.inputs, (2 * k + 1) * WIDTH + lane, w)
    for i in range(p.vehicles):
        for k in range(nodes):
            place, to = (p.vehicles * row + i) * nodes + k, 2 * (p.vehicles * k + i)
            poke(work.others, to * WIDTH + lane, peek(jobs.other_x, place))
            poke(work.others, (to + 1) * WIDTH + lane, peek(jobs.other_y, place))
    for number in (AGE, DAMPING, FAILED, SPENT):
        poke(work.status, number * WIDTH + lane, 0.0)
    poke(work.status, JOB * WIDTH + lane, float(job))


@kernel
def _finish(p: Programme, path: Path, work: Workspace, answer: Answer, job: int, lane: int) -> None:
    """Write down the result of a lane."""
    for i in range(4 * (p.steps + 1)):
        poke(answer.states, 4 * (p.steps + 1) * job + i, peek(path.states, i * WIDTH + lane))
    for i in range(2 * p.steps):
        poke(answer.inputs, 2 * p.steps * job + i, peek(path.inputs, i * WIDTH + lane))
    cost = peek(work.status, COST * WIDTH + lane) + peek(work.status, PENALTY * WIDTH + lane)
    poke(answer.cost, job, cost)
    poke(answer.excess, job, peek(work.status, EXCESS * WIDTH + lane))
    poke(answer.status, job, peek(work.status, ENDED * WIDTH + lane) - 1.0)
    poke(answer.iterations, job, peek(work.status, SPENT * WIDTH + lane))


def _entry(sources: str) -> Callable[..., str]:
    """Compile the kernel.

    numba identifies cached machine code by the values of the closure, hence the digest of the sources.
    """

    @entry
    def solve_all(
        p: Programme,
        bounds: Bounds,
        tuning: Tuning,
        jobs: Jobs,
        count: int,
        answer: Answer,
        path: Path,
        trial: Path,
        work: Workspace,
    ) -> str:
        store(work.status, JOB, splat(-1.0))
        following = running = 0
        for lane in range(min(WIDTH, count)):
            _begin(p, bounds, path, work, jobs, following, lane)
            following += 1
            running += 1
        while running > 0:
            tick(p, tuning, path, trial, work, bounds)
            path, trial = trial, path
            if any_of(load(work.status, ENDED) > 0.0):
                penalty, excess = penalties(p, path)
                store(work.status, PENALTY, penalty)
                store(work.status, EXCESS, excess)
                for lane in range(WIDTH):
                    job = int(peek(work.status, JOB * WIDTH + lane))
                    if job < 0 or peek(work.status, ENDED * WIDTH + lane) == 0.0:
                        continue
                    _finish(p, path, work, answer, job, lane)
                    if following < count:
                        _begin(p, bounds, path, work, jobs, following, lane)
                        following += 1
                    else:
                        poke(work.status, JOB * WIDTH + lane, -1.0)
                        running -= 1
        return sources

    return solve_all


solve_all = _entry(sources_digest())
"""Kernel that searches the programmes of ``jobs`` into ``answer``."""
