"""Functions behind the methods of values: ``result.plot()`` calls ``plot_results``.

Each imports what it needs when it is called, so that ``import avrare`` is fast.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from avrare.analysis.causes.attribution import Attribution
    from avrare.analysis.causes.kinds import Kinds
    from avrare.estimation.loop.loop import Progress
    from avrare.estimation.result.result import Result
    from avrare.output.session.plot import Plot
    from avrare.output.session.trace import Trace
    from avrare.results.run import Run
    from avrare.rollout.problem import Problem


def plot_results(results: Sequence[Result]) -> Plot:
    """Draw results; see ``Result.plot``."""
    from avrare.output.session.result_plot import plot_results

    return plot_results(results)


def trace_problem(problem: Problem, noise: Any = None) -> Trace:
    """Run one rollout of a problem; see ``Problem.trace``."""
    from avrare.output.session.trace import trace_problem

    return trace_problem(problem, noise)


def trace_result(result: Result, index: int | None = None) -> Trace:
    """Replay one rollout of a result; see ``Result.trace``."""
    from avrare.output.session.trace import trace_result

    return trace_result(result, index)


def find_kinds(result: Result, max_kinds: int, method: str) -> Kinds:
    """Sort the failures of a result into kinds; see ``Result.kinds``."""
    from avrare.analysis.causes.kinds import kinds_of_result

    return kinds_of_result(result, max_kinds, method)


def attribute_failures(result: Result, fresh: int, channels: bool, workers: int) -> Attribution:
    """Attribute the failures of a result to noise; see ``Result.attribution``."""
    from avrare.analysis.causes.attribution import attribution_of_result

    return attribution_of_result(result, fresh, channels, workers)


def write_report(results: Sequence[Result] | Run, path: str | os.PathLike[str]) -> Path:
    """Write the HTML report; see ``Run.report``."""
    from avrare.output.session.python_report import write_report

    return write_report(results, path)


def render_table(results: Sequence[Result]) -> str:
    """Return results as the HTML table of a notebook."""
    from avrare.output.session.notebook_table import render_results

    return render_results(results)


def show_progress(label: str, problem: Problem, confidence: float | None) -> AbstractContextManager[Progress]:
    """Show the live line of an estimate."""
    from avrare.output.session.live_progress import show_progress

    return show_progress(label, problem, confidence)


RENDERERS = (
    plot_results,
    trace_problem,
    trace_result,
    find_kinds,
    attribute_failures,
    write_report,
    render_table,
    show_progress,
)
