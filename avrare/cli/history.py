"""``avrare history``: keep results, and show how estimates went over commits."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from avrare.errors import ExitCode, PluginError, UsageError, did_you_mean

_EXAMPLE = """\
A history is filled by hand, or by the job that ran: nothing else writes to it. Adding
a folder again adds nothing. DIR is the --out of `avrare run` or `avrare check`.

examples:
  avrare history add runs/night
  avrare history lane_change --specification safe_distance --limit 20
  avrare history --plot trend.png
  avrare history add out --store postgresql://host/avrare
"""
_ADD = "add"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``avrare history``."""
    parser.epilog = _EXAMPLE
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.usage = "avrare history [SCENARIO] [options]\n       avrare history add DIR... [--store URL]"
    parser.add_argument("words", nargs="*", metavar="SCENARIO", help="its name; or 'add' and folders of runs")
    parser.add_argument("--specification", metavar="NAME", help="only this one")
    parser.add_argument(
        "--limit", type=int, default=20, metavar="N", help="the newest N (default 20; 0: all)"
    )
    parser.add_argument("--json", action="store_true", help="print the entries as JSON and nothing else")
    parser.add_argument("--plot", metavar="FILE", help="draw them as a PNG")
    parser.add_argument(
        "--store",
        metavar="URL",
        help="a file, or a database as SQLAlchemy names it; default .avrare/history.sqlite",
    )


def execute(args: argparse.Namespace) -> int:
    """Add results, or show them."""
    if args.words[:1] == [_ADD]:
        _add(args)
    else:
        _show(args)
    return int(ExitCode.PASS)


def _add(args: argparse.Namespace) -> None:
    from avrare.history.entry import entries

    if len(args.words) < 2:
        raise UsageError("avrare history add: the folder is missing", "avrare history add DIR...")
    found = [entry for name in args.words[1:] for entry in entries(Path(name))]
    with _store(args, create=True) as store:
        added = store.add(found)
        known = f", {len(found) - added} were there already" if added < len(found) else ""
        print(f"{added} of {len(found)} estimates added to {store.place}{known}")


def _show(args: argparse.Namespace) -> None:
    if len(args.words) > 1:
        raise UsageError(
            f"one scenario, not {len(args.words)}: {' '.join(args.words)}", "avrare history add DIR..."
        )
    if args.limit < 0:
        raise UsageError(f"--limit must be at least 0, not {args.limit}")
    shown = _newest(_chosen(args), args.limit)
    if args.plot is not None:
        _plot(shown, Path(args.plot))
    if args.json:
        print(json.dumps({"schema": 1, "entries": [entry.to_dict() for entry in shown]}))
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


def _newest(found: list[Any], limit: int) -> list[Any]:
    """Of each specification; all for a limit of 0."""
    from avrare.history.entry import series

    return [entry for _, entries in series(found) for entry in entries[-limit:]]


def _print(shown: list[Any]) -> None:
    from avrare.history.entry import breaks, series
    from avrare.history.screen import notes, table
    from avrare.report.console import screen, show

    console, broken = screen("auto"), False
    for index, ((scenario, specification), entries) in enumerate(series(shown)):
        if index:
            console.print()
        show(console, table(scenario, specification, entries))
        broken |= any(breaks(entries))
    for line in notes(shown, broken):
        console.print(line, style="yellow", markup=False)


def _plot(shown: list[Any], path: Path) -> None:
    from avrare.history.picture import draw
    from avrare.report.picture import available

    if not available():
        raise PluginError("--plot needs matplotlib", "pip install 'avrare[plot]'")
    if path.suffix.lower() != ".png":
        raise UsageError(f"--plot {path}: the picture is a PNG", "name it FILE.png")
    try:
        draw(shown, path)
    except OSError as error:
        raise UsageError(
            f"{path}: cannot write the picture: {error.strerror}", "choose another place"
        ) from None


def _store(args: argparse.Namespace, create: bool) -> Any:
    from avrare.history.store import DEFAULT, Store

    return Store(args.store or DEFAULT, create=create)
