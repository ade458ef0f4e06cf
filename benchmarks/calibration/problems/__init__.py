"""Problems of the benchmark by name; NumPy is all that they need, so that any tool's environment has them."""

from __future__ import annotations

from functools import cache

from benchmarks.calibration.problems.chains import chain_problems
from benchmarks.calibration.problems.driving import driving_problems
from benchmarks.calibration.problems.problem import Problem
from benchmarks.calibration.problems.static import static_problems


@cache
def problems() -> dict[str, Problem]:
    """Return all problems by name."""
    return {one.name: one for one in (*static_problems(), *chain_problems(), *driving_problems())}
