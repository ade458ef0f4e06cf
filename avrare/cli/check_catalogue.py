"""``avrare check`` of a catalogue: the thresholds of its rates."""

from __future__ import annotations

import argparse
import sys

from avrare.analysis.check.criteria import Decision
from avrare.analysis.check.gate import CheckResult
from avrare.analysis.rates.catalogue import Catalogue, is_catalogue, load_catalogue
from avrare.analysis.rates.rates import CatalogueRates
from avrare.base.errors import ExitCode, UsageError
from avrare.base.number_format import format_interval, format_probability
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
    outcome = _outcome(rates)
    for name, text in ((args.junit, junit), (args.markdown, markdown)):
        if name is not None:
            write_file(name, text(outcome), "choose another file")
    if is_github_job():
        write_summary(outcome)
        paths = {catalogue.document.name: catalogue.path}
        for line in annotate_rows(outcome, paths):
            print(line, file=sys.stderr if args.json else sys.stdout)
    assumes = args.strict and rates.verdict == "pass_assuming"
    return int(ExitCode.INCONCLUSIVE if assumes and not rates.errors else rates.exit_code)


def _thresholds(args: argparse.Namespace) -> Catalogue:
    path = next(filter(is_catalogue, args.scenarios))
    if len(args.scenarios) > 1:
        raise UsageError(f"{path}: is a catalogue, which is checked alone", "run avrare check for each")
    for name in _OF_SCENARIOS:
        given = getattr(args, name)
        if given is not None and given is not False and given != []:  # a seed may be 0
            option = "--" + name.replace("_", "-")
            hint = "change the catalogue; its rates are compared with its thresholds, and with no baseline"
            raise UsageError(f"{option} is an option of scenarios, and {path} is a catalogue", hint)
    catalogue = load_catalogue(path)
    if not catalogue.document.thresholds:
        hint = "add one, such as {rule: no_collision, per_hour: '< 1e-3'}, or run avrare rate"
        raise UsageError(f"{path}: has no thresholds to check", hint)
    return catalogue


def _outcome(rates: CatalogueRates) -> CheckResult:
    # The rows of a check; what it calls a probability is none here, so the rate stands in the reason.
    name, rows = rates.catalogue.document.name, []
    broken = f"more rollouts ended in an error than allowed: {', '.join(rates.errors)}"
    for one in rates.rates:
        for found in one.decisions:
            total = one.totals[found.threshold.unit]
            numbers = f"{format_probability(total.value)} ({format_interval(total.interval)})"
            parts = [f"{numbers} per {found.threshold.unit}", *found.reasons, *[broken] * bool(rates.errors)]
            question = found.threshold.text
            rows.append(Decision(name, one.rule, "threshold", question, found.verdict, "; ".join(parts)))
    return CheckResult(tuple(rows), {name: ()})
