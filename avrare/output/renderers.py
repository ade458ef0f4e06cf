"""Functions that draw and write values: ``avrare.plot(result)``, and so ``result.plot()``.

Each imports its modules when it is called, so that ``import avrare`` is fast.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from avrare.analysis.compare.comparison import Comparison
    from avrare.analysis.monitor.monitoring import MonitoringResult
    from avrare.base.plot import Plot
    from avrare.estimation.loop.loop import Progress
    from avrare.estimation.result.result import Result, ResultMapping
    from avrare.output.report import Source
    from avrare.rollout.problem import Problem
    from avrare.rollout.replay import Trace


def plot(
    value: Result | ResultMapping | Trace | Comparison | MonitoringResult, signals: Sequence[str] = ()
) -> Plot:
    """Draw a result, a run, a trace, a comparison or a monitored drive (needs matplotlib).

    Args:
        value: Object to draw.
        signals: Names of the signals of a trace; none: those of its formula.

    Returns:
        A plot that a notebook shows; ``.save(path)`` writes it.
    """
    from avrare.analysis.compare.comparison import Comparison
    from avrare.analysis.monitor.monitoring import MonitoringResult
    from avrare.base.errors import UsageError
    from avrare.estimation.result.result import Result, ResultMapping
    from avrare.output.plots.estimate_plots import plot_comparison, plot_results
    from avrare.output.plots.monitoring_plot import plot_monitoring
    from avrare.output.plots.rollout_plot import plot_trace
    from avrare.rollout.replay import Trace

    match value:
        case Trace():
            return plot_trace(value, signals)
        case Comparison():
            return plot_comparison(value)
        case MonitoringResult():
            return plot_monitoring(value)
        case Result():
            return plot_results([value])
        case ResultMapping():
            return plot_results(list(value.values()))
    hint = "plot a result, a run (avrare.Run.read of a folder), a trace, a comparison or a monitored drive"
    raise UsageError(f"a {type(value).__name__} has no plot", hint)


def report(source: Source, path: str | os.PathLike[str] | None = None) -> Path:
    """Write a run, results of ``avrare.estimate`` or the rates of a catalogue as one HTML file.

    Args:
        source: Run or its folder, results, or rates.
        path: File; None: ``report.html`` in the folder of the run or the rates.

    Returns:
        Path of the file.

    Raises:
        UsageError: The file cannot be written, there is neither a path nor a folder, or a result does not
            know its problem.
    """
    from avrare.output.report import write_report

    return write_report(source, path)


def render_html(results: ResultMapping) -> str:
    """Return results as the HTML table of a notebook."""
    from avrare.output.notebook import render_table

    return render_table(list(results.values()))


def show_progress(label: str, problem: Problem, confidence: float | None) -> AbstractContextManager[Progress]:
    """Show the live line of an estimate."""
    from avrare.output.notebook import show_progress

    return show_progress(label, problem, confidence)


RENDERERS = (plot, report, render_html, show_progress)
