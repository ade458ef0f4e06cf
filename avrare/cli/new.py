"""``avrare new plugin``: a complete package to begin with."""

from __future__ import annotations

import argparse
from pathlib import Path

from avrare.authors.package import check_name, write
from avrare.errors import ExitCode
from avrare.plugin.component import KINDS
from avrare.plugin.registry import default_registry


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("what", choices=["plugin"], help="what to make")
    parser.add_argument("name", metavar="NAME", help="as scenarios will write it, for example wind_gusts")
    parser.add_argument("--kind", required=True, metavar="KIND", help=f"one of {', '.join(KINDS)}")
    parser.add_argument("--out", default=".", metavar="DIR", help="where to make the folder avrare-NAME")


def execute(args: argparse.Namespace) -> int:
    """Write the package and say what to do next."""
    name = check_name(args.name, args.kind, default_registry())
    folder = write(name, args.kind, Path(args.out))
    print(f"{folder}: {args.kind} {name!r}")
    print(f"next: pip install -e '{folder}[test]' && avrare check-plugin {name} && pytest {folder}")
    return int(ExitCode.PASS)
