"""``avrare report``: a run's folder as one HTML file."""

from __future__ import annotations

import argparse
from pathlib import Path

from avrare.errors import ExitCode, UsageError

_EXAMPLE = """\
DIR is the folder that `avrare run` has written. The report is one file that loads nothing
from anywhere: send it by mail, or keep it with the build.

examples:
  avrare run scenarios/lane_change.yaml --out runs/night
  avrare report runs/night --open
  avrare report runs/night --out lane_change.html
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``avrare report``."""
    parser.epilog = _EXAMPLE
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("folder", metavar="DIR", help="folder of a run")
    parser.add_argument("--out", metavar="FILE", help="default: report.html in DIR")
    parser.add_argument("--open", action="store_true", help="show it in the browser")


def execute(args: argparse.Namespace) -> int:
    """Write the report and say where."""
    from avrare.record.whole import write_text
    from avrare.report.html.page import report

    folder = Path(args.folder)
    path = Path(args.out) if args.out is not None else folder / "report.html"
    if path.is_dir():
        raise UsageError(f"--out {path}: is a folder, not a file to write", "name the file")
    text = report(folder)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)
    except OSError as error:
        raise UsageError(
            f"{path}: cannot write the report: {error.strerror}", "choose another --out"
        ) from None
    print(f"report in {path}")
    if args.open:
        import webbrowser

        webbrowser.open(path.resolve().as_uri())
    return int(ExitCode.PASS)
