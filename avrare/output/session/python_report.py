"""HTML report of a run: its model built, and drawn as a page."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from avrare.analysis.page.build import build_report
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.estimation.result.result import Result
from avrare.output.html.page import render_page
from avrare.results.run import Run


def render_report(folder: str | os.PathLike[str]) -> str:
    """Return the report of a run folder as HTML.

    Raises:
        UsageError: The folder has no result, or a file in it is damaged.
    """
    return render_run(Run.read(folder))


def render_run(run: Run) -> str:
    """Return the report of a run as HTML."""
    return render_page(build_report(run))


def write_report(results: Sequence[Result] | Run, path: str | os.PathLike[str]) -> Path:
    """Write a run, or results of ``avrare.estimate``, as one HTML file and return its path.

    Raises:
        UsageError: The file cannot be written, or a result does not know its problem.
    """
    file = Path(path)
    text = render_run(results if isinstance(results, Run) else Run.of_results(results))
    with explain_file_errors(f"{file}: cannot write", "choose another file"):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_text(file, text)
    return file
