"""Adapter of SENTIL: chains and lattices written as its expressions, ten runs of its splitting."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import sentil
from sentil import NoiseModel, RareEventConfig, SimExpr, SimModel

from benchmarks.calibration.answer import Answer, Counted, NoAnswerError, of_runs

RUNS = 10


def tool_version() -> str:
    """Return the version of SENTIL."""
    return version("sentil")


def estimate(method: str, counted: Counted, budget: int, seed: int, options: dict[str, Any]) -> Answer:
    """Return the mean of ten runs of budget / 500 particles.

    It simulates by itself, so the evaluations are the simulations that it reports.
    """
    system = counted.problem.system
    move, bound = _EXPRESSIONS[type(system).__name__](system)
    model = SimModel(
        ["x"], 1.0, system.steps, [SimExpr.constant(0.0)], [move], [NoiseModel.gaussian(0.0, 1.0)]
    )
    formula = sentil.parse(f"P>=0.5 (G[0,{system.steps}] ({bound}))")
    simulated, values = model.to_stochastic_system(), []
    for run in range(RUNS):
        config = RareEventConfig(particles=max(budget // 500, 10), seed=RUNS * seed + run)
        try:
            result = formula.check_rare_event(simulated, config)
        except sentil.SentilError as error:
            raise NoAnswerError(str(error)) from error
        counted.evaluations += result.simulations
        values.append(float(result.violation_probability))
    return of_runs(values)


def _chain(system: Any) -> tuple[Any, str]:
    move = SimExpr.prev(0) * SimExpr.constant(system.decay)
    return move + SimExpr.noise(0) * SimExpr.constant(system.scale), f"x < {system.level}"


def _lattice(system: Any) -> tuple[Any, str]:
    """Return a step of -1 below the threshold: 0 or 1 is a floor, cut off."""
    above = (SimExpr.noise(0) - SimExpr.constant(system.threshold)).floor() + SimExpr.constant(1.0)
    above = above.max(SimExpr.constant(0.0)).min(SimExpr.constant(1.0))
    move = above * SimExpr.constant(system.otherwise + 1.0) - SimExpr.constant(1.0)
    return SimExpr.prev(0) + move, f"x > {-system.depth}"


_EXPRESSIONS = {"Chain": _chain, "Lattice": _lattice}
