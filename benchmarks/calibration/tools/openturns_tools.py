"""Adapter of OpenTURNS: its simulation algorithms on a threshold event over standard normals."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import openturns as ot
import openturns.experimental as experimental

from benchmarks.calibration.answer import Answer, Counted, NoAnswerError

BLOCK = 100
"""Rows of a call of the black box."""


def tool_version() -> str:
    """Return the version of OpenTURNS."""
    return str(ot.__version__)


def estimate(method: str, counted: Counted, budget: int, seed: int, options: dict[str, Any]) -> Answer:
    """Return the answer of one of its algorithms, with its own 95 % confidence length.

    A coefficient of variation that it does not state, or a length of 0, is no interval.
    """
    ot.Log.Show(ot.Log.NONE)
    ot.RandomGenerator.SetSeed(seed)
    d = counted.problem.dimension
    stopped: list[NoAnswerError] = []

    def rows(points: Any) -> Any:
        try:
            return counted.robustness(np.asarray(points))[:, None]
        except NoAnswerError as error:
            stopped.append(error)  # its message does not come back through OpenTURNS
            raise

    model = ot.Function(ot.PythonFunction(d, 1, func_sample=rows))
    event = ot.ThresholdEvent(
        ot.CompositeRandomVector(model, ot.RandomVector(ot.Normal(d))), ot.LessOrEqual(), 0.0
    )
    try:
        algorithm = _METHODS[method](event, counted, budget, options)
        algorithm.run()
        result = algorithm.getResult()
        p, length = float(result.getProbabilityEstimate()), float(result.getConfidenceLength(0.95))
    except Exception as error:
        if "bad_alloc" in str(error):
            raise MemoryError from error
        raise stopped[0] if stopped else NoAnswerError(" ".join(str(error).split())[:200]) from error
    if not math.isfinite(p):
        raise NoAnswerError("its probability is not a number")
    deviation = float(result.getCoefficientOfVariation())
    if not (p > 0.0 and math.isfinite(length) and length > 0.0 and deviation > 0.0):
        return Answer(p, None)
    return Answer(p, (max(p - length / 2.0, 0.0), p + length / 2.0))


def _sized(algorithm: Any, rows: int) -> Any:
    """Give an algorithm so many rows, of each level where it has levels."""
    block = max(min(BLOCK, rows), 1)
    algorithm.setBlockSize(block)
    algorithm.setMaximumOuterSampling(max(rows // block, 1))
    return algorithm


def _monte_carlo(event: Any, counted: Counted, budget: int, options: dict[str, Any]) -> Any:
    return _sized(ot.ProbabilitySimulationAlgorithm(event, ot.MonteCarloExperiment()), budget)


def _subset(event: Any, counted: Counted, budget: int, options: dict[str, Any]) -> Any:
    algorithm = ot.SubsetSampling(event)
    if "conditional_probability" in options:
        algorithm.setConditionalProbability(options["conditional_probability"])
    return _sized(algorithm, budget // options["levels"])


def _directional(event: Any, counted: Counted, budget: int, options: dict[str, Any]) -> Any:
    if options.get("safe"):
        algorithm = ot.DirectionalSampling(event, ot.SafeAndSlow(ot.Brent()), ot.OrthogonalDirection())
    else:
        algorithm = ot.DirectionalSampling(event)
    # A direction takes a root search along 8 units, about 10 evaluations.
    algorithm.setBlockSize(1)
    algorithm.setMaximumOuterSampling(max(budget // 10, 1))
    return algorithm


def _design_point(event: Any, counted: Counted, budget: int) -> Any:
    form = ot.FORM(ot.AbdoRackwitz(), event, [0.0] * counted.problem.dimension)
    form.run()
    return form.getResult()


def _form_importance(event: Any, counted: Counted, budget: int, options: dict[str, Any]) -> Any:
    point = _design_point(event, counted, budget).getStandardSpaceDesignPoint()
    law = ot.Normal(point, ot.CovarianceMatrix(counted.problem.dimension))
    algorithm = ot.ProbabilitySimulationAlgorithm(event, ot.ImportanceSamplingExperiment(law))
    return _sized(algorithm, max(int(budget - counted.evaluations), BLOCK))


def _cross_entropy(event: Any, counted: Counted, budget: int, options: dict[str, Any]) -> Any:
    return _sized(
        ot.StandardSpaceCrossEntropyImportanceSampling(event, options.get("quantile", 0.25)),
        budget // options["levels"],
    )


def _nais(event: Any, counted: Counted, budget: int, options: dict[str, Any]) -> Any:
    return _sized(experimental.NAIS(event, options.get("quantile", 0.25)), budget // options["levels"])


def _line(event: Any, counted: Counted, budget: int, options: dict[str, Any]) -> Any:
    alpha = _design_point(event, counted, budget).getStandardSpaceDesignPoint()
    root = ot.MediumSafe(ot.Brent()) if options.get("safe") else ot.RootStrategy(ot.SafeAndSlow())
    algorithm = experimental.LineSampling(event, alpha, root)
    algorithm.setBlockSize(1)
    algorithm.setMaximumOuterSampling(max(int(budget - counted.evaluations) // 10, 1))
    return algorithm


_METHODS: dict[str, Callable[[Any, Counted, int, dict[str, Any]], Any]] = {
    "monte carlo": _monte_carlo, "subset": _subset, "directional": _directional,
    "form-is": _form_importance, "cross-entropy": _cross_entropy, "nais": _nais, "line": _line,
}  # fmt: skip
