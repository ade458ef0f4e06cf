"""``avrare new plugin``: a complete plugin package from templates."""

from __future__ import annotations

import argparse
from pathlib import Path

from avrare.base.errors import ExitCode
from avrare.plugin.component import KINDS
from avrare.plugin.new_package import check_name, write
from avrare.plugin.registry import default_registry


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("what", choices=["plugin"], help="what to create")
    parser.add_argument("name", metavar="NAME", help="name in scenarios, for example wind_gusts")
    parser.add_argument("--kind", required=True, metavar="KIND", help=f"one of {', '.join(KINDS)}")
    parser.add_argument("--out", default=".", metavar="DIR", help="parent of the new folder (default: .)")


def execute(args: argparse.Namespace) -> int:
    """Write the package and print the next commands."""
    name = check_name(args.name, args.kind, default_registry())
    folder = write(name, args.kind, Path(args.out))
    print(f"{folder}: {args.kind} {name!r}")
    print(f"next: pip install -e '{folder}[test]' && avrare check-plugin {name} && pytest {folder}")
    return int(ExitCode.PASS)
