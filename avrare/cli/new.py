"""``avrare new plugin``: a complete plugin package from templates."""

from __future__ import annotations

import argparse
from pathlib import Path

from avrare.cli.output import say
from avrare.plugin.new_package import check_name, write
from avrare.plugin.registry import default_registry


def execute(args: argparse.Namespace) -> None:
    """Write the package and print the next commands."""
    name = check_name(args.name, args.kind, default_registry())
    folder = write(name, args.kind, Path(args.out))
    say(f"{folder}: {args.kind} {name!r}")
    say(f"next: pip install -e '{folder}[test]' && avrare check-plugin {name} && pytest {folder}")
