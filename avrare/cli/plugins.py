"""``avrare plugins``: the installed components and their status."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import time
from importlib.metadata import entry_points

from rich import box
from rich.markup import escape
from rich.table import Table

from avrare.base.errors import ExitCode, UsageError, did_you_mean
from avrare.cli.output import say
from avrare.output.terminal.console import make_console
from avrare.plugin.component import GROUP, KINDS
from avrare.plugin.registry import VARIABLE, Row, default_registry


def execute(args: argparse.Namespace) -> int:
    """Print one row per component and per plugin that could not be loaded, or check components."""
    if args.kind is not None and args.kind not in KINDS:
        raise UsageError(f"--kind: unknown kind {args.kind!r}", did_you_mean(args.kind, KINDS))
    if args.check is not None:
        if args.timing:
            raise UsageError("--timing cannot be combined with --check", "leave one of them out")
        from avrare.cli.plugin_checks import check_components  # NumPy, which listing does without

        return check_components(args)
    if args.set:
        raise UsageError("--set requires --check", "it sets options of the component that is checked")
    seconds = _import_seconds() if args.timing else None
    rows = [row for row in default_registry().rows() if args.kind in (None, row.kind)]
    if args.json:
        print(json.dumps([_entry(row, seconds) for row in rows], indent=2))
    else:
        _print_table(rows, seconds)
    return int(ExitCode.PASS)


def _import_seconds() -> dict[str, float]:
    names = os.environ.get(VARIABLE)
    seconds: dict[str, float] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        blocked = names is not None and point.name not in [name.strip() for name in names.split(",")]
        if blocked or point.dist is None:
            continue
        began = time.perf_counter()
        with contextlib.suppress(Exception, SystemExit):  # the registry reports it
            point.load()
        elapsed = time.perf_counter() - began
        seconds[point.dist.name] = seconds.get(point.dist.name, 0.0) + elapsed
    return seconds


def _entry(row: Row, seconds: dict[str, float] | None) -> dict[str, object]:
    columns = ("kind", "name", "distribution", "version", "status", "detail", "summary")
    entry = {key: getattr(row, key) for key in columns}
    return entry if seconds is None else {**entry, "import_seconds": seconds.get(row.distribution)}


def _print_table(rows: list[Row], seconds: dict[str, float] | None) -> None:
    headings = ["kind", "name", "from", "status", "summary"]
    if seconds is not None:
        headings.insert(3, "import")
    table = Table(*headings, box=box.SIMPLE_HEAD, pad_edge=False)
    for row in rows:
        colour = "green" if row.status == "ok" else "red"
        texts = [escape(text) for text in (row.kind or "?", row.name, row.origin, row.status, row.summary)]
        texts[3] = f"[{colour}]{texts[3]}[/{colour}]"
        if seconds is not None:
            elapsed = seconds.get(row.distribution)
            texts.insert(3, "" if elapsed is None else f"{1000.0 * elapsed:.0f} ms")
        table.add_row(*texts)
    for column in table.columns:
        column.overflow = "fold"  # names and pip commands must not be truncated
    print_wide(table)
    for detail in dict.fromkeys(f"{row.name}: {row.detail}" for row in rows if row.detail):
        say(detail)


def print_wide(table: Table) -> None:
    """Print a table; in a pipe, which has no width, nothing wraps and no line ends in blanks."""
    if sys.stdout.isatty():
        make_console(soft_wrap=False, highlight=True).print(table)
        return
    with (console := make_console(soft_wrap=False, highlight=True, width=240)).capture() as captured:
        console.print(table)
    print("\n".join(line.rstrip() for line in captured.get().splitlines() if line.strip()))
