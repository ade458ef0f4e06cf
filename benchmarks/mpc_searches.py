"""Share of the lane change's failures that is due to the controller's local search.

    OMP_NUM_THREADS=1 python benchmarks/mpc_searches.py [--rollouts 5000] [--seed 11] [NAME...]

Simulates the same noise tapes with controllers that differ only in the number of searches per step: every
search starts from another barrier or another initial guess and ends in a local minimum, and the cheapest
counts. Prints how many rollouts violated each rule.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from avrare.rollout.engine import simulate
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.scenario.load import load
from avrare_mpc.riccati.solver import FROM_NEAR, QUICK, RiccatiSolver, Solutions
from avrare_mpc.riccati.values import Tuning

SCENARIO, BATCH = "scenarios/lane_change_published.yaml", 1000


def rough(start: float) -> Tuning:
    """Return the tuning of a search that only finds out which minimum it is."""
    return Tuning(start=start, end=1e-4, reduce=0.1, step=1e-2, iterations=60)


NEAR, NEARER, FAR, FARTHER = rough(1e-3), rough(1e-4), rough(0.3), rough(10.0)
DRIVE = rough(3e-2)
SEARCHES: dict[str, tuple[list[Tuning], list[int]]] = {
    "far": ([FAR], []),
    "nearer": ([NEARER], []),  # as shipped
    "near+nearer": ([NEAR, NEARER], []),
    "nearer+farther": ([NEARER, FARTHER], []),
    "nearer+one drive": ([NEARER], [3]),
    "nearer+all drives": ([NEARER], [0, 1, 2, 3]),
}
"""Barriers of the rough searches from the old plan, and indices of initial guesses to try, by name."""


class BestOf:
    """A solver in the place of ``RiccatiSolver``: the cheapest of several minima of each programme."""

    def __init__(self, search: Any, config: Any, scene: Any, roughs: list[Tuning], drives: list[int]) -> None:
        def solver(tuning: Tuning) -> RiccatiSolver:
            return RiccatiSolver(config, scene, quick=tuning, patient=tuning, near=None)

        self.search, self.drives = search, drives
        self.first = RiccatiSolver(config, scene, quick=QUICK, near=None)
        self.roughs, self.from_drive, self.last = (
            [solver(t) for t in roughs],
            solver(DRIVE),
            solver(FROM_NEAR),
        )

    def solve(self, start: Any, x: Any, y: Any, rows: Any, guesses: Any) -> Solutions:
        """See ``RiccatiSolver.solve``."""
        best = self.first.solve(start, x, y, rows, guesses)
        others = [solver.solve(start, x, y, rows, guesses) for solver in self.roughs]
        if len(rows) == len(start):  # not the first step, which tries the drives anyway
            drives = self.search._initial_guesses(start)[rows]
            others += [self.from_drive.solve(start, x, y, rows, drives[:, number]) for number in self.drives]
        for other in others:
            promising = ~best.found | (other.cost < (1.0 - 1e-3) * best.cost)
            again = np.flatnonzero(promising & np.isfinite(other.inputs).all(axis=(1, 2)))
            if len(again):
                self._finish(best, again, start, x, y, rows, other.inputs)
        return best

    def _finish(
        self, best: Solutions, again: Any, start: Any, x: Any, y: Any, rows: Any, inputs: Any
    ) -> None:
        found = self.last.solve(start, x, y, rows[again], inputs[again])
        better = found.found & (~best.found[again] | (found.cost < best.cost[again]))
        for name in ("states", "inputs", "cost", "found", "retried"):
            getattr(best, name)[again[better]] = getattr(found, name)[better]


def main() -> None:
    """Print a line for each way to search."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(SEARCHES))
    parser.add_argument("--rollouts", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=11)
    args = parser.parse_args()
    scenario = LoadedScenario(load(SCENARIO, ["controller.backend=riccati"]))
    problem = scenario.problem(scenario.specifications)
    controller = scenario.stack.loop.controller
    monitors = tuple(scenario.stack.specifications.values())
    print(f"{args.rollouts} rollouts, seed {args.seed}: {'  '.join(scenario.specifications)}")
    for name in args.names:
        search = controller._search  # type: ignore[union-attr]
        search._solver = BestOf(search, controller._config, scenario.scene, *SEARCHES[name])  # type: ignore[union-attr]
        broken, began = np.zeros(len(monitors), dtype=int), time.process_time()
        for first in range(0, args.rollouts, BATCH):
            index = np.arange(first, min(first + BATCH, args.rollouts))
            request = Request.from_start(np.zeros_like(index), index)
            noise = NoiseSource(args.seed, problem.noise_size)
            broken += simulate(
                scenario.stack.loop, monitors, problem.steps, noise, request, scored=False
            ).violated.sum(axis=0)
        each = 1e3 * (time.process_time() - began) / args.rollouts
        print(
            f"{name:20s} {'  '.join(f'{count:5d}' for count in broken)}   {each:.1f} ms a rollout", flush=True
        )


if __name__ == "__main__":
    main()
