"""``avrare new``: a complete plugin package, or a scenario file."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path

from avrare.base.errors import UsageError
from avrare.cli.output import say
from avrare.plugin.new_package import check_name, write
from avrare.plugin.registry import default_registry
from avrare.stack.new_scenario import write_scenario


def execute(args: argparse.Namespace) -> None:
    """Write the package or the scenario and print the next commands."""
    if args.what == "scenario":
        _write_scenario(args)
        return
    if args.act:
        raise UsageError("--act is for scenarios", "avrare new scenario NAME --simulator NAME --act")
    if args.kind is None:
        raise UsageError("--kind is required for a plugin", "for example --kind controller")
    name = check_name(args.name, args.kind, default_registry())
    folder = write(name, args.kind, Path(args.out), driving=not args.no_driving)
    say(f"{folder}: {args.kind} {name!r}")
    say(f"next: pip install -e '{folder}[test]' && avrare check-plugin {name} && pytest {folder}")


def _write_scenario(args: argparse.Namespace) -> None:
    if args.kind is not None or args.no_driving:
        raise UsageError(
            "--kind and --no-driving are for plugins", "avrare new scenario NAME --simulator NAME"
        )
    name = args.name.removesuffix(".yaml")
    if not re.fullmatch(r"\w[\w.-]*", name):
        raise UsageError(f"{args.name!r} is no name for a scenario", "for example cut_in")
    path = Path(args.out) / f"{name}.yaml"
    signals = write_scenario(path, args.simulator, args.set, default_registry(), args.act)
    file = shlex.quote(str(path))
    say(f"{path}: signals {', '.join(signals)}")
    if args.act:
        say(f"{path.with_suffix('.py')}: act(observation), the controller")
    say(f"next: avrare validate --build {file} && avrare run {file}")
