"""``avrare report``: a run folder as one HTML file."""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from avrare.cli.output import print_warnings, say
from avrare.estimation.loop.checkpoint import FOLDER, INDEX, resume_hint
from avrare.output.report import write_report


def execute(args: argparse.Namespace) -> None:
    """Write the report and print its path."""
    folder = Path(args.folder)
    path = (folder if args.out is None else Path(args.out)) / "report.html"
    say(f"report in {write_report(folder, path)}")
    for home in dict.fromkeys((folder, folder.parent)):  # that of several scenarios is beside their folders
        if (home / FOLDER / INDEX).exists():
            text = f"{home}: contains an interrupted run as well, which the report does not show"
            print_warnings([(text, resume_hint(home))])
    if args.open:
        webbrowser.open(path.resolve().as_uri())
