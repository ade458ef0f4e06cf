"""``avrare check`` of a catalogue: the thresholds of its rates."""

from __future__ import annotations

import argparse
import sys

from avrare.analysis.check.check import choose_catalogue, decide_rates
from avrare.cli import rate
from avrare.cli.output import ensure_files, write_file
from avrare.output.documents import annotate_rows, is_github_job, junit, markdown, write_summary

_OF_SCENARIOS = (
    "set",
    "estimator",
    "seed",
    "looks",
    "baseline",
    "save",
    "require_baseline",
    "accept_changes",
    "plan",
)
"""Options that a catalogue has no use for, or has keys of its own for."""


def execute(args: argparse.Namespace) -> int:
    """Estimate the rates of the catalogue, report their verdicts, and return the exit code."""
    catalogue = choose_catalogue(args.scenarios, **{name: getattr(args, name) for name in _OF_SCENARIOS})
    ensure_files({"--junit": args.junit, "--markdown": args.markdown})
    rates = rate.estimate(
        argparse.Namespace(
            **{name: getattr(args, name) for name in ("workers", "executor", "budget", "json")},
            **{name: getattr(args, name) for name in ("quiet", "plain", "out", "resume")},
            catalogue=catalogue.path,
            against=None,
        ),
        "check",
    )
    outcome = decide_rates(rates, args.strict)
    for name, text in ((args.junit, junit), (args.markdown, markdown)):
        if name is not None:
            write_file(name, text(outcome), "choose another file")
    if is_github_job():
        write_summary(outcome)
        paths = {catalogue.document.name: catalogue.path}
        for line in annotate_rows(outcome, paths):
            print(line, file=sys.stderr if args.json else sys.stdout)
    return int(outcome.exit_code)
