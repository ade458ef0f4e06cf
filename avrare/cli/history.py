"""``avrare history``: store results, and show estimates over commits."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from avrare.analysis.history.entry import find_breaks, group_series, read_entries
from avrare.analysis.history.store import DEFAULT, HistoryStore
from avrare.base.atomic_files import explain_file_errors
from avrare.base.errors import PluginError, UsageError, did_you_mean
from avrare.cli.output import say
from avrare.report.plots import has_matplotlib
from avrare.report.plots.history_plot import draw
from avrare.report.terminal.console import make_console, print_lines, print_table
from avrare.report.terminal.result_table import history_note_lines, history_table


def execute(args: argparse.Namespace) -> None:
    """Add results to the history, or show it."""
    if args.words[:1] == ["add"]:
        _add(args)
    else:
        _show(args)


def _add(args: argparse.Namespace) -> None:
    if len(args.words) < 2:
        raise UsageError("avrare history add: DIR is required", "avrare history add DIR...")
    found = [entry for name in args.words[1:] for entry in read_entries(Path(name))]
    with _store(args, create=True) as store:
        added = store.add(found)
        known = f", {len(found) - added} were stored already" if added < len(found) else ""
        say(f"{added} of {len(found)} estimates added to {store.location}{known}")


def _show(args: argparse.Namespace) -> None:
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
    console, broken = make_console("auto"), False
    for index, ((scenario, specification), entries) in enumerate(group_series(shown)):
        if index:
            console.print()
        print_table(console, history_table(scenario, specification, entries))
        broken |= any(find_breaks(entries))
    print_lines(console, history_note_lines(shown, broken), "yellow")


def _plot(shown: list[Any], path: Path) -> None:
    if not has_matplotlib():
        raise PluginError("--plot needs matplotlib", "pip install 'avrare[plot]'")
    if path.suffix.lower() != ".png":
        raise UsageError(f"--plot {path}: the picture is written as PNG", "use the suffix .png")
    if not shown:
        raise UsageError("--plot: the history is empty", "add results: avrare history add DIR...")
    with explain_file_errors(f"{path}: cannot write", "choose another --plot"):
        draw(shown, path)


def _store(args: argparse.Namespace, create: bool) -> Any:
    return HistoryStore(args.store or DEFAULT, create=create)
