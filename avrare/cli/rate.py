"""``avrare rate``: rates of rule violations per hour and km, over the scenes of a catalogue."""

from __future__ import annotations

import argparse
import json
import shlex
from pathlib import Path

from avrare.analysis.rates.catalogue import load_catalogue
from avrare.analysis.rates.rate import choose_folder, load_scenes, rate_catalogue
from avrare.analysis.rates.rates import CatalogueRates
from avrare.base.errors import Interrupted
from avrare.cli.options import display
from avrare.cli.output import find_resumed_folder, print_warnings, say
from avrare.cli.run import estimate_run
from avrare.estimation.plan.budget import Budget
from avrare.output.renderers import report
from avrare.output.terminal.console import make_console
from avrare.output.terminal.rate_table import print_rates
from avrare.rollout.executors.interruption import Stopping
from avrare.scenario.safe_mode import is_safe


def execute(args: argparse.Namespace) -> int:
    """Estimate the rates of the catalogue, and return the exit code of the verdict."""
    return int(estimate(args).exit_code)


def estimate(args: argparse.Namespace, command: str = "rate") -> CatalogueRates:
    """Estimate the rates of a catalogue, and show and write them.

    Args:
        args: As of ``avrare rate``.
        command: The command that resumes after an interruption.
    """
    catalogue = load_catalogue(args.catalogue)
    budget, scenes = catalogue.budget(Budget.parse(args.budget)), load_scenes(catalogue)
    out = find_resumed_folder(args) or choose_folder(catalogue, args.out)
    print_warnings(warning for scene in scenes for warning in scene.warnings)
    try:
        with Stopping() as stop:
            rates = rate_catalogue(
                catalogue,
                scenes,
                budget,
                out,
                args.resume,
                lambda scenario, paid, checkpoint: estimate_run(scenario, args, paid, checkpoint, stop),
                args.against,
            )
    except (Interrupted, KeyboardInterrupt) as error:
        hint = f"resume with {_resume_command(command, args, out)}"
        raise Interrupted("interrupted, finished chunks are saved", hint) from error
    report(rates)
    if args.json:
        print(json.dumps(rates.to_dict(), indent=2))
    else:
        print_rates(make_console(display(args)), rates, quiet=display(args) == "quiet")
        folders = "scenes and own" if any(catalogue.own_rules) else "scenes"
        say(f"results in {out}: rate.json, report.html, a run folder of each scene in {folders}")
    return rates


def _resume_command(command: str, args: argparse.Namespace, out: Path) -> str:
    budget = ["--budget", str(args.budget)] if args.budget is not None else []
    budget += ["--against", args.against] if args.against is not None else []
    safe = ["--safe"] if is_safe() else []
    return shlex.join(["avrare", command, args.catalogue, "--out", str(out), "--resume", *budget, *safe])
