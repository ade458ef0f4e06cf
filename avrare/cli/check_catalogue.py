"""``avrare check`` of a catalogue: the thresholds of its rates."""

from __future__ import annotations

import argparse
import sys

from avrare.analysis.check.check import choose_catalogue, decide_rates, refuse_option
from avrare.analysis.rates.catalogue import Catalogue
from avrare.cli import rate
from avrare.cli.output import ensure_files, write_file
from avrare.output.documents.check_documents import junit, markdown
from avrare.output.documents.github_output import annotate_rows, is_github_job, write_summary

_OF_SCENARIOS = (
    "set",
    "estimator",
    "seed",
    "spend",
    "baseline",
    "save",
    "require_baseline",
    "accept_changes",
    "plan",
)
"""Options that a catalogue has no use for, or has keys of its own for."""


def execute(args: argparse.Namespace) -> int:
    """Estimate the rates of the catalogue, report their verdicts, and return the exit code."""
    catalogue = _thresholds(args)
    ensure_files({"--junit": args.junit, "--markdown": args.markdown})
    rates = rate.estimate(
        argparse.Namespace(
            **{name: getattr(args, name) for name in ("workers", "executor", "budget", "json")},
            **{name: getattr(args, name) for name in ("quiet", "plain", "out", "resume")},
            catalogue=catalogue.path,
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


def _thresholds(args: argparse.Namespace) -> Catalogue:
    catalogue = choose_catalogue(args.scenarios)
    for name in _OF_SCENARIOS:
        given = getattr(args, name)
        if given is not None and given is not False and given != []:  # a seed may be 0
            raise refuse_option("--" + name.replace("_", "-"), catalogue.path)
    return catalogue
