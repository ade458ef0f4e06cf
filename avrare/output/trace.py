"""Export of the trace of a rollout: of a problem, a scenario, a result or a run."""

from __future__ import annotations

import os
from pathlib import Path

from numpy.typing import ArrayLike

from avrare.base.errors import UsageError
from avrare.estimation.result.result import Result
from avrare.results.run import Run
from avrare.rollout.loaded_scenario import open_problem, select_specification
from avrare.rollout.problem import Problem
from avrare.rollout.replay import Trace, trace_tape


def trace(
    source: Problem | Result | Run | str | os.PathLike[str],
    noise: int | ArrayLike | None = None,
    specification: str | None = None,
) -> Trace:
    """Run one rollout and return its signals over time.

    Args:
        source: Problem or scenario file; or a result, a run or a run folder.
        noise: Noise tape (steps + 1, noise_size), or the number of a failure that the result keeps. None:
            the noise-free rollout of a problem or scenario, the least robust rollout of a result or run.
        specification: Specification that judges it; None: the only one.

    Raises:
        UsageError: The tape does not fit, no failure has the number, or the specification must be named.
    """
    if isinstance(source, (str, os.PathLike)) and Path(source).is_dir():
        source = Run.read(source)
    if isinstance(source, Run):
        source = source[select_specification(list(source), specification, source.name)]
    if isinstance(source, Result):
        if noise is None or isinstance(noise, int):
            return source.trace(noise)
        return trace_tape(source.require_origin().problem, noise)
    if isinstance(noise, int):
        raise UsageError(f"failure {noise} of a problem is not known", "give its result, its run or a tape")
    return trace_tape(open_problem(source, specification), noise)
