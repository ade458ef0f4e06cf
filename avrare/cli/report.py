"""``avrare report``: a run folder as one HTML file."""

from __future__ import annotations

import argparse
from pathlib import Path

from avrare.base.errors import ExitCode, UsageError
from avrare.cli.output import write_errors
from avrare.cli.parser import set_epilog

_EPILOG = """\
DIR is a folder written by `avrare run`. The report is a single file without external
resources: send it by mail, or archive it with the build.

examples:
  avrare run scenarios/lane_change.yaml --out runs/night
  avrare report runs/night --open
  avrare report runs/night --out lane_change.html
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    set_epilog(parser, _EPILOG)
    parser.add_argument("folder", metavar="DIR", help="run folder")
    parser.add_argument("--out", metavar="FILE", help="report file (default: report.html in DIR)")
    parser.add_argument("--open", action="store_true", help="open the report in the browser")


def execute(args: argparse.Namespace) -> int:
    """Write the report and print its path."""
    from avrare.base.files import write_text
    from avrare.report.html.page import render_report

    folder = Path(args.folder)
    path = Path(args.out) if args.out is not None else folder / "report.html"
    if path.is_dir():
        raise UsageError(f"--out {path}: is a folder, not a file", "give the path of a file")
    text = render_report(folder)
    with write_errors(path, "choose another --out"):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)
    print(f"report in {path}")
    if args.open:
        import webbrowser

        webbrowser.open(path.resolve().as_uri())
    return int(ExitCode.PASS)
