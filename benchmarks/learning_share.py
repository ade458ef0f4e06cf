"""Share of learning in an estimate: CPU time of features, network, proposal and training, on one core.

OMP_NUM_THREADS=1 python -m benchmarks.learning_share SCENARIO SPECIFICATION ESTIMATOR [OPTION=VALUE ...]
"""

from __future__ import annotations

import ast
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import avrare
from avrare.rollout import engine
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare_estimators.importance.lessons import Lessons
from avrare_estimators.importance.tape_mixture import TapeMixture
from avrare_estimators.smc import potentials
from avrare_estimators.smc.defended_mixture import DefendedMixture
from avrare_estimators.smc.network import Network

_DRAWING = ("choose", "transform", "evidence", "log_ratio")
TIMED: dict[str, list[tuple[Any, str]]] = {
    "features": [(engine._Simulation, "_features")],
    "network": [(Network, "log_odds")],
    "proposal": [(owner, name) for owner in (TapeMixture, DefendedMixture) for name in _DRAWING],
    "training": [(Lessons, "learn"), (Lessons, "final"), (potentials, "fit")],
}
"""Functions of each part; what one of them calls counts for the outer one."""


class Clocks:
    """CPU time by part, without what is called inside another."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = defaultdict(float)
        self._inside = False

    def wrap(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function with its time added to the part's."""

        def timed(*args: Any, **keywords: Any) -> Any:
            if self._inside:
                return function(*args, **keywords)
            self._inside, began = True, time.process_time()
            try:
                return function(*args, **keywords)
            finally:
                self._inside = False
                self.spent[part] += time.process_time() - began

        return timed


def main(path: str, specification: str, estimator: str, settings: list[str]) -> None:
    """Print the shares of one estimate."""
    options = {key: ast.literal_eval(value) for key, value in (one.split("=", 1) for one in settings)}
    scenario = LoadedScenario(load(path))
    problem = scenario.problem([specification])
    problem.nominal()  # loads and compiles
    clocks = Clocks()
    for part, functions in TIMED.items():
        for owner, name in functions:
            setattr(owner, name, clocks.wrap(part, getattr(owner, name)))
    warnings.simplefilter("ignore", avrare.HealthWarning)
    began = time.process_time()
    result = avrare.estimate(problem, estimator, seed=1, **options)
    total = time.process_time() - began
    steps = result.simulated_steps
    print(f"{path} {specification}, {estimator}: {result.probability:.3g} from {steps:,} steps")
    print(f"  {total:.1f} CPU s, {1e6 * total / steps:.0f} us a step")
    for note in filter(None, (result.diagnostics.get("note"), ", ".join(result.health))):
        print(f"  {note}")
    for part in TIMED:
        spent = clocks.spent[part]
        print(f"  {part:9s} {1e6 * spent / steps:7.1f} us a step  {spent / total:6.2%}")


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    main(*sys.argv[1:4], sys.argv[4:])
