"""``avrare history``: store results, and show estimates over commits."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from avrare.base.errors import ExitCode, PluginError, UsageError, did_you_mean
from avrare.cli.output import write_errors
from avrare.cli.parser import at_least, set_epilog

_EPILOG = """\
`avrare history add` stores the estimates of DIR, the --out of `avrare run` or `avrare check`.
Nothing else writes to the history. Adding a folder twice has no effect.

examples:
  avrare history add runs/night
  avrare history lane_change --specification safe_distance --limit 20
  avrare history --plot trend.png
  avrare history add out --store postgresql://host/avrare
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    set_epilog(parser, _EPILOG)
    parser.usage = "avrare history [SCENARIO] [options]\n       avrare history add DIR... [--store URL]"
    parser.add_argument(
        "words", nargs="*", metavar="SCENARIO", help="scenario name, or 'add' and run folders"
    )
    parser.add_argument("--specification", metavar="NAME", help="show only this specification")
    parser.add_argument(
        "--limit", type=at_least(0), default=20, metavar="N", help="show the newest N (default 20; 0: all)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else on stdout")
    parser.add_argument("--plot", metavar="FILE", help="draw the estimates as a PNG")
    parser.add_argument(
        "--store",
        metavar="URL",
        help="SQLite file, or SQLAlchemy URL of a database (default .avrare/history.sqlite)",
    )


def execute(args: argparse.Namespace) -> int:
    """Add results to the history, or show it."""
    if args.words[:1] == ["add"]:
        _add(args)
    else:
        _show(args)
    return int(ExitCode.PASS)


def _add(args: argparse.Namespace) -> None:
    from avrare.analysis.history.entry import read_entries

    if len(args.words) < 2:
        raise UsageError("avrare history add: DIR is required", "avrare history add DIR...")
    found = [entry for name in args.words[1:] for entry in read_entries(Path(name))]
    with _store(args, create=True) as store:
        added = store.add(found)
        known = f", {len(found) - added} were stored already" if added < len(found) else ""
        print(f"{added} of {len(found)} estimates added to {store.location}{known}")


def _show(args: argparse.Namespace) -> None:
    from avrare.analysis.history.entry import group_series

    if len(args.words) > 1:
        raise UsageError(
            f"give one scenario, not {len(args.words)}: {' '.join(args.words)}",
            "to add results: avrare history add DIR...",
        )
    shown = [entry for _, entries in group_series(_chosen(args)) for entry in entries[-args.limit :]]
    if args.plot is not None:
        _plot(shown, Path(args.plot))
    if args.json:
        print(json.dumps({"schema": 1, "entries": [vars(entry) for entry in shown]}))
    else:
        _print(shown)


def _chosen(args: argparse.Namespace) -> list[Any]:
    scenario = args.words[0] if args.words else None
    with _store(args, create=False) as store:
        found, known = store.read(scenario), store.scenarios()
    if scenario is not None and not found:
        raise UsageError(f"the history has no scenario {scenario!r}", did_you_mean(scenario, known))
    names = sorted({entry.specification for entry in found})
    if args.specification is not None and args.specification not in names:
        problem = f"the history has no specification {args.specification!r}"
        raise UsageError(problem, did_you_mean(args.specification, names))
    return [entry for entry in found if args.specification in (None, entry.specification)]


def _print(shown: list[Any]) -> None:
    from avrare.analysis.history.entry import find_breaks, group_series
    from avrare.report.terminal.console import make_console, print_lines, print_table
    from avrare.report.terminal.result_table import history_note_lines, history_table

    console, broken = make_console("auto"), False
    for index, ((scenario, specification), entries) in enumerate(group_series(shown)):
        if index:
            console.print()
        print_table(console, history_table(scenario, specification, entries))
        broken |= any(find_breaks(entries))
    print_lines(console, history_note_lines(shown, broken), "yellow")


def _plot(shown: list[Any], path: Path) -> None:
    from avrare.report.plots.figure import has_matplotlib
    from avrare.report.plots.history_plot import draw

    if not has_matplotlib():
        raise PluginError("--plot needs matplotlib", "pip install 'avrare[plot]'")
    if path.suffix.lower() != ".png":
        raise UsageError(f"--plot {path}: the picture is written as PNG", "use the suffix .png")
    with write_errors(path, "choose another --plot"):
        draw(shown, path)


def _store(args: argparse.Namespace, create: bool) -> Any:
    from avrare.analysis.history.store import DEFAULT, HistoryStore

    return HistoryStore(args.store or DEFAULT, create=create)
