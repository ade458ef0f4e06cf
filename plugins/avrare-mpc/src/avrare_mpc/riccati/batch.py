"""Many searches, one after another: the kernels that Python calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from avrare_mpc.riccati.cost import penalties
from avrare_mpc.riccati.jit import entry, kernel, sources_digest
from avrare_mpc.riccati.newton import search
from avrare_mpc.riccati.values import Floats, Others, Programme, Tuning, new_path, new_workspace

Integers = NDArray[np.int64]

ROOM = 0.98
"""Part of the input bounds that a start may use."""


class Answer(NamedTuple):
    """Where M searches ended.

    Attributes:
        states: (M, H + 1, 4).
        inputs: (M, H, 2).
        cost: (M,) with the lateral penalty.
        excess: (M,) the farthest that speed or heading are outside their bounds.
        status: (M,) FOUND, UNFINISHED or STUCK.
        iterations: (M,).
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


def _entry(bounds: int, sources: str) -> Callable[..., str]:
    """The kernel where the first ``bounds`` soft bounds count: as a constant it is a third faster.

    numba finds machine code on disk by what a function closes over, hence the sources' digest.
    """

    @entry
    def solve_all(
        p: Programme,
        tuning: Tuning,
        start: Floats,
        other_x: Floats,
        other_y: Floats,
        rows: Integers,
        guesses: Floats,
        answer: Answer,
    ) -> str:
        steps, vehicles = guesses.shape[1], other_x.shape[1]
        one, two, work = new_path(steps, vehicles), new_path(steps, vehicles), new_workspace(steps)
        for m in range(len(rows)):
            n = rows[m]
            one.states[0] = start[n]
            for k in range(steps):
                one.inputs[k, 0] = _clip(guesses[m, k, 0], ROOM * p.acceleration_max)
                one.inputs[k, 1] = _clip(guesses[m, k, 1], ROOM * p.turn_rate_max)
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


solve_without_bounds = _entry(1, sources_digest())
"""Fills ``answer`` with the searches of programmes ``rows`` from ``guesses``; only y is bounded."""
solve_with_bounds = _entry(3, sources_digest())
"""The same with bounds of y, speed and heading."""
