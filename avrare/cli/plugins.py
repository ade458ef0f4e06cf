"""``avrare plugins``: what is installed, and what is wrong with it."""

from __future__ import annotations

import argparse
import json
import sys

from avrare.errors import ExitCode
from avrare.plugin.registry import Row, default_registry

_COLUMNS = ("kind", "name", "distribution", "version", "status", "detail", "summary")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("--json", action="store_true", help="print a list of objects instead of a table")


def execute(args: argparse.Namespace) -> int:
    """Print one row for each component and for each plugin that could not be loaded."""
    rows = default_registry().rows()
    if args.json:
        print(json.dumps([{key: getattr(row, key) for key in _COLUMNS} for row in rows], indent=2))
    else:
        _print_table(rows)
    return int(ExitCode.PASS)


def _print_table(rows: list[Row]) -> None:
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table("kind", "name", "from", "status", "summary", box=box.SIMPLE_HEAD, pad_edge=False)
    for row in rows:
        status = row.status if not row.detail else f"{row.status}: {row.detail}"
        colour = "green" if row.status == "ok" else "red"
        cells = (row.kind or "?", row.name, row.origin, status, row.summary)
        texts = [escape(text) for text in cells]
        texts[3] = f"[{colour}]{texts[3]}[/{colour}]"
        table.add_row(*texts)
    # A pipe has no width: give it enough that nothing wraps.
    Console(width=None if sys.stdout.isatty() else 240).print(table)
