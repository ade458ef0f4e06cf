"""Problem behind a result, for analyses that run rollouts."""

from __future__ import annotations

from avrare.base.errors import UsageError
from avrare.estimation.result import Result
from avrare.rollout.problem import Problem


def require_problem(result: Result) -> Problem:
    """Return the problem that a result was made of.

    Raises:
        UsageError: It was not made in this process.
    """
    if result.origin is None:
        raise UsageError(
            "this result was not made in this process, so its rollouts cannot be run again",
            "`avrare kinds SCENARIO --run DIR` and `avrare attribution SCENARIO --run DIR` work on a folder",
        )
    return result.origin.problem
