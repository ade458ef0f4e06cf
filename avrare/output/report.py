"""HTML report of a run: its model built, and drawn as a page."""

from __future__ import annotations

import os
from pathlib import Path

from avrare.analysis.page.build import build_report
from avrare.analysis.page.rates import build_rates
from avrare.analysis.rates.rates import CatalogueRates
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError, require_path
from avrare.estimation.result.result import Result, ResultMapping
from avrare.output.html.page import render_page, render_rates
from avrare.results.run import Run

Source = Run | ResultMapping | Result | CatalogueRates | str | os.PathLike[str]


def write_report(source: Source, path: str | os.PathLike[str] | None) -> Path:
    """Write the report of ``avrare.report``."""
    content = source if isinstance(source, CatalogueRates) else _open_run(source)
    path_argument = None if path is None else require_path(path, "a file for the report")
    file = path_argument or (content.folder and content.folder / "report.html")
    if file is None:
        raise UsageError("the report has no folder", 'name a file, such as "report.html"')
    text = render_report(content)
    with explain_file_errors(f"{file}: cannot write", "choose another file"):
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        write_text(Path(file), text)
    return Path(file)


def render_report(source: Source) -> str:
    """Return the report as HTML."""
    if isinstance(source, CatalogueRates):
        return render_rates(build_rates(source))
    return render_page(build_report(_open_run(source)))


def _open_run(source: Run | ResultMapping | Result | str | os.PathLike[str]) -> Run:
    match source:
        case Run():
            return source
        case Result():
            return Run.of_results([source])
        case ResultMapping():
            return Run.of_results(list(source.values()))
    return Run.read(source)
