"""HTML report of a run: its model built, and drawn as a page."""

from __future__ import annotations

import os
from pathlib import Path

from avrare.analysis.page.build import build_report
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.estimation.result.result import Result, ResultMapping
from avrare.output.html.page import render_page
from avrare.results.run import Run

Source = Run | ResultMapping | Result | str | os.PathLike[str]


def write_report(source: Source, path: str | os.PathLike[str] | None) -> Path:
    """Write the report of ``avrare.report``."""
    run = open_run(source)
    file = path or (run.folder and run.folder / "report.html")
    if file is None:
        raise UsageError(f"{run.name} has no folder for its report", 'name a file, such as "report.html"')
    text = render_report(run)
    with explain_file_errors(f"{file}: cannot write", "choose another file"):
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        write_text(Path(file), text)
    return Path(file)


def render_report(source: Source) -> str:
    """Return the report of a run, its folder or results as HTML."""
    return render_page(build_report(open_run(source)))


def open_run(source: Source) -> Run:
    """Return a run, that of a folder, or the one that results make together.

    Raises:
        UsageError: The folder has no run, or a result does not know its problem.
    """
    match source:
        case Run():
            return source
        case Result():
            return Run.of_results([source])
        case ResultMapping():
            return Run.of_results(list(source.values()))
    return Run.read(source)
