"""Cost of the checks of an estimate, as shares of all rows that were passed to ``System.step``."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import avrare
from avrare.estimation.result import Result
from avrare.rollout.problem import Problem
from studies.untuned_problems import untuned_problem

SCENARIOS = Path(__file__).parents[2] / "scenarios"
FILE = Path(__file__).parents[1] / "results" / "check_costs.md"
"""File of the table for the page."""
_SMALL: dict[str, dict[str, Any]] = {
    "ams": {"particles": 10, "discard": 1, "grow": True, "budget": "rollouts=1100"},
    "ess": {"chains": 2, "runs": 2},
    "ce": {"rollouts": 30},
    "mc": {"rollouts": 100},
}
"""Sizes for the lane change, whose rollouts take long; all other problems have the defaults."""


class Counting:
    """System that counts the rows that it steps, those of checks too."""

    def __init__(self, system: Any) -> None:
        self.system = system
        self.rows = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.system, name)

    def step(self, state: Any, noise: Any) -> Any:
        """Step the system."""
        self.rows += len(noise)
        return self.system.step(state, noise)


@dataclass(frozen=True)
class Cost:
    """Rows of one estimate.

    Attributes:
        problem: Its name.
        estimator: Its name.
        rows: All rows, also those that no result counts.
        probes: Rows of the tests for determinism and of the rollouts that give the terms' sizes.
        checks: Rows of the pilot (ams) and of the second look and its climb (ce).
    """

    problem: str
    estimator: str
    rows: int
    probes: int
    checks: int

    @property
    def share(self) -> float:
        """Share of the checks in all rows."""
        return (self.probes + self.checks) / self.rows


def measure() -> Iterator[Cost]:
    """Yield the cost of every estimator on three problems."""
    for title, make, sizes in _problems():
        for name in ("ams", "ess", "ce", "mc"):
            yield cost_of(title, make(), name, **sizes.get(name, {}))


def cost_of(title: str, problem: Problem, name: str, **sizes: Any) -> Cost:
    """Estimate once, and count."""
    system = problem.system = Counting(problem.system)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = avrare.estimate(problem, name, **sizes)
    checks = round(_check_share(result) * result.simulated_steps)
    return Cost(title, name, system.rows, system.rows - result.simulated_steps, checks)


def _check_share(result: Result) -> float:
    # Of the rollouts; those of a check are about as long as the others.
    found = result.diagnostics
    if result.estimator == "ams" and "pilot_roots" in found:
        return 1.0 - (found["full_rollouts"] + found["branched_rollouts"]) / result.rollouts
    return float(found.get("check_rollouts", 0)) / result.rollouts


def _problems() -> Iterator[tuple[str, Callable[[], Problem], dict[str, dict[str, Any]]]]:
    lane = avrare.load(
        SCENARIOS / "lane_change.yaml", ["controller.backend=riccati", "controller.search=follow"]
    )
    boxes = avrare.load(SCENARIOS / "double_integrator.yaml")
    yield "two conjuncts of different units, exact", untuned_problem("units_100").problem, {}
    yield "double_integrator", partial(boxes.problem, "clear"), {}
    yield "lane change, R_G1, riccati", partial(lane.problem, "safe_distance"), _SMALL


def table(costs: Iterator[Cost]) -> list[str]:
    """Return the lines of the table."""
    lines = ["| problem | estimator | rows stepped | probes | pilot or second look | share |"]
    lines.append("|---|---|---|---|---|---|")
    for one in costs:
        cells = (one.problem, f"`{one.estimator}`", f"{one.rows:,}", f"{one.probes:,}", f"{one.checks:,}")
        lines.append(f"| {' | '.join(cells)} | {one.share:.1%} |")
        print(lines[-1], flush=True)
    return lines


def main() -> None:
    """Print the table and keep it."""
    FILE.parent.mkdir(parents=True, exist_ok=True)
    FILE.write_text("\n".join(table(measure())) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
