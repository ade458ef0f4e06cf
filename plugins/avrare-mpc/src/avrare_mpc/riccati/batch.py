"""Entry kernels: many searches, one after another."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from avrare_mpc.plan import Integers
from avrare_mpc.riccati.cost import penalties
from avrare_mpc.riccati.jit import entry, kernel, sources_digest
from avrare_mpc.riccati.newton import search
from avrare_mpc.riccati.values import Bounds, Floats, Others, Programme, Tuning, new_path, new_workspace

GUESS_SHARE = 0.98
"""Share of the input bounds that a guess may use."""


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

    states: Floats
    inputs: Floats
    cost: Floats
    excess: Floats
    status: Integers
    iterations: Integers


@kernel
def _clip(value: float, limit: float) -> float:
    return max(min(value, limit), -limit)


def _entry(bounds: Bounds, sources: str) -> Callable[..., str]:
    """Compile the kernel in which ``bounds`` count; as a constant they make it a third faster.

    numba identifies cached machine code by the values of the closure, hence the digest of the sources.
    """

    @entry
    def solve_all(
        p: Programme, tuning: Tuning, start: Floats, other_x: Floats, other_y: Floats, rows: Integers,
        guesses: Floats, answer: Answer,
    ) -> str:  # fmt: skip
        steps, vehicles = guesses.shape[1], other_x.shape[1]
        one, two, work = new_path(steps, vehicles), new_path(steps, vehicles), new_workspace(steps)
        for m in range(len(rows)):
            n = rows[m]
            one.states[0] = start[n]
            speed = start[n, 2]
            for k in range(steps):
                one.inputs[k, 0] = _clip(guesses[m, k, 0], GUESS_SHARE * p.acceleration_max)
                one.inputs[k, 1] = _clip(guesses[m, k, 1], GUESS_SHARE * p.turn_rate_max)
                if bounds.hard > 4:
                    one.inputs[k, 1] = _clip(one.inputs[k, 1], GUESS_SHARE * p.lateral_max / abs(speed))
                    speed += p.dt * one.inputs[k, 0]
            path, cost, status, spent = search(
                p, tuning, one, two, work, Others(other_x[n], other_y[n]), bounds
            )
            penalty, excess = penalties(p, path)
            answer.states[m] = path.states
            answer.inputs[m] = path.inputs
            answer.cost[m], answer.excess[m] = cost + penalty, excess
            answer.status[m], answer.iterations[m] = status, spent
        return sources

    return solve_all


solve_without_bounds = _entry(Bounds(hard=4, soft=1), sources_digest())
"""Kernel that searches programmes ``rows`` from ``guesses`` into ``answer``; of states, y is bounded."""
solve_with_bounds = _entry(Bounds(hard=4, soft=3), sources_digest())
"""Kernel with bounds of y, speed and heading."""
solve_lateral_without_bounds = _entry(Bounds(hard=6, soft=1), sources_digest())
"""``solve_without_bounds`` that bounds the lateral acceleration, too."""
solve_lateral_with_bounds = _entry(Bounds(hard=6, soft=3), sources_digest())
"""``solve_with_bounds`` that bounds the lateral acceleration, too."""
