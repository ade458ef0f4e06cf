"""Nominal flight of the glider by direct collocation; needs CasADi.

    python benchmarks/glider_nominal_flight.py plugins/avrare-glider/src/avrare_glider/nominal.npz

The problem is that of Drake's example of the perching glider: cost, bounds, start and wire are the published
ones. The time is fixed to the 0.66 s of stl-ess (there it is free, and the cheapest flight takes longer), the
input is constant over each step of the simulator, and each step is a Hermite-Simpson interval.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from avrare.protocols import Floats
from avrare_glider.aircraft import DT, ELEVATOR_STOPS, NAMES, RATE_LIMIT, START, advance, rates
from avrare_glider.nominal import Flight

STEPS = 66
RUNNING_COST = 100.0
FINAL_COST = (10.0, 10.0, 1.0, 10.0, 1.0, 1.0, 1.0)
GOAL = (0.0, 0.0, np.pi / 4, 0.0, 0.0, 0.0, 0.0)
BOUNDS = ((-4.0, 1.0), (-1.0, 1.0), (-np.pi / 2, np.pi / 2), ELEVATOR_STOPS)
"""Of x, z, pitch and elevator, all the way."""
ARRIVAL = ((0.0, 0.0), (0.0, 0.0), (np.pi / 6, 1.0), (-np.inf, np.inf), (-2.0, 2.0), (-2.0, 2.0))
"""Of the first six at the end."""


def optimise(guess: Flight | None = None) -> Flight:
    """Return the cheapest flight to the wire.

    Args:
        guess: Start of the search; None: a straight line that slows down.

    Raises:
        RuntimeError: The solver has found no flight.
    """
    guess = guess if guess is not None else straight()
    problem = ca.Opti()
    states, inputs = problem.variable(len(NAMES), STEPS + 1), problem.variable(1, STEPS)
    defects = _hermite_simpson().map(STEPS)(states[:, :-1], states[:, 1:], inputs)
    problem.subject_to(ca.vec(defects) == 0)
    problem.subject_to(states[:, 0] == ca.DM(START))
    problem.subject_to(problem.bounded(-RATE_LIMIT, inputs, RATE_LIMIT))
    for i, (low, high) in enumerate(BOUNDS):
        problem.subject_to(problem.bounded(low, states[i, 1:], high))
    for i, (low, high) in enumerate(ARRIVAL):
        if np.isfinite(low):
            problem.subject_to(problem.bounded(low, states[i, -1], high))
    error = states[:, -1] - ca.DM(GOAL)
    problem.minimize(RUNNING_COST * DT * ca.sumsqr(inputs) + ca.dot(ca.DM(FINAL_COST) * error, error))
    problem.set_initial(states, guess.states.T)
    problem.set_initial(inputs, guess.inputs)
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "max_iter": 2000})
    return flown(np.asarray(problem.solve().value(inputs)))


def straight() -> Flight:
    """Return a guess: from the start to the wire in a line, slowing down, the nose coming up."""
    done = np.linspace(0.0, 1.0, STEPS + 1)[:, None]
    states = (1.0 - done) * START + done * GOAL
    speed = START[4] * (1.0 - 0.75 * done[:, 0])
    way = np.append(0.0, np.cumsum(speed[1:] + speed[:-1]))
    states[:, 0], states[:, 4] = START[0] * (1.0 - way / way[-1]), speed
    return Flight(states, np.zeros(STEPS))


def flown(inputs: Floats) -> Flight:
    """Simulate the flight of inputs (K,), so that without noise there is nothing to correct."""
    rows: list[Any] = [tuple(np.array([value]) for value in START)]
    for rate in inputs:
        rows.append(advance(rows[-1], np.array([rate])))
    return Flight(np.array(rows)[:, :, 0], np.asarray(inputs, dtype=np.float64))


def _hermite_simpson() -> Any:
    """Return the function (state, next state, input) -> error of Simpson's rule at the next state."""
    a, b, u = ca.SX.sym("a", len(NAMES)), ca.SX.sym("b", len(NAMES)), ca.SX.sym("u")
    slope_a, slope_b = _rates(a, u), _rates(b, u)
    middle = _rates((a + b) / 2 + DT / 8 * (slope_a - slope_b), u)
    return ca.Function("defect", [a, b, u], [b - a - DT / 6 * (slope_a + 4 * middle + slope_b)])


def _rates(state: Any, rate: Any) -> Any:
    return ca.vertcat(*rates(tuple(ca.vertsplit(state)), rate, ca))


if __name__ == "__main__":
    found = optimise()
    np.savez(Path(sys.argv[1]), states=found.states, inputs=found.inputs)
    print(f"ends at {np.array2string(found.states[-1], precision=5, suppress_small=True)}")
