"""``avrare check``: thresholds and baselines, turned into an exit code."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from avrare.base.errors import ExitCode, UsageError
from avrare.cli.output import print_warnings, refuse_overwrite, write_errors, write_files
from avrare.cli.parser import (
    add_display_arguments,
    add_run_arguments,
    add_scenario_arguments,
    display,
    load_scenarios,
    overrides,
    set_epilog,
)

_EPILOG = """\
A threshold passes if the interval of the probability lies below the bound, and fails if it
lies above. Each specification is also compared with the newest baseline, a numbered file in
baselines/NAME next to the scenario, if there is one; the first comparison saves it. See
docs/ci.md.

examples:
  avrare check scenarios/*.yaml --junit report.xml --markdown summary.md
  avrare check drive.yaml --spend rollouts=80000    # up to four looks, until all verdicts are clear
  avrare check drive.yaml --plan                    # estimate the cost of a verdict
  avrare check drive.yaml --save                    # save a new baseline

exit code: 0 all pass, 1 a threshold or comparison fails, 3 inconclusive, 4 bad scenario or
usage, 5 plugin missing, 6 too many rollout errors
"""
_PILOT_ROLLOUTS = 200


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    set_epilog(parser, _EPILOG)
    add_scenario_arguments(parser)
    add_run_arguments(parser)
    parser.add_argument(
        "--spend",
        metavar="KIND=N",
        help="maximal budget, spent in up to four interim looks until every verdict is decided",
    )
    folder = parser.add_argument_group("baselines")
    folder.add_argument(
        "--baseline",
        metavar="DIR",
        help="baseline folder (DIR/NAME for several scenarios); implies a comparison",
    )
    folder.add_argument("--save", action="store_true", help="save this run as the new baseline")
    folder.add_argument(
        "--require-baseline", action="store_true", help="stop if there is no baseline; recommended in CI"
    )
    text = "compare even if the scenario has changed since the baseline"
    folder.add_argument("--accept-changes", action="store_true", help=text)
    output = parser.add_argument_group("output")
    output.add_argument("--plan", action="store_true", help="only estimate the cost of a verdict")
    output.add_argument("--junit", metavar="FILE", help="write JUnit XML")
    output.add_argument("--markdown", metavar="FILE", help="write a summary for a merge request")
    output.add_argument("--out", metavar="DIR", help="write check.json and the run folders")
    output.add_argument("--json", action="store_true", help="print check.json and nothing else on stdout")
    add_display_arguments(parser)


def execute(args: argparse.Namespace) -> int:
    """Check the scenarios together, report, and return the exit code of the verdict."""
    from avrare.analysis.check.targets import plan_looks
    from avrare.estimation.budget import Budget

    budget, spend = Budget.parse(args.budget), Budget.parse(args.spend)
    if budget and spend:
        raise UsageError("--budget cannot be combined with --spend", "remove one of them")
    _make_folders(args)
    subjects = _subjects(args)
    if args.out and not args.plan:
        refuse_overwrite(Path(args.out), "check.json", [one.definition.name for one in subjects])
    if args.plan:
        return _plan(args, subjects, budget)
    from avrare.analysis.check.gate import check
    from avrare.report.terminal.check_table import print_check

    outcome = check(subjects, plan_looks(budget, spend), _machine(args), args.save)
    _write(args, subjects, outcome)
    if args.json:
        print(json.dumps(outcome.to_dict(subjects)))
    else:
        print_check(outcome, display(args))
    return int(outcome.exit_code)


def _subjects(args: argparse.Namespace) -> list[Any]:
    from avrare.analysis.check.baseline import default_folder
    from avrare.analysis.check.targets import load_target

    scenarios = load_scenarios(args, overrides(args))
    for scenario in scenarios:
        print_warnings(scenario.warnings)
    found = []
    for scenario in scenarios:
        folder = default_folder(scenario) if args.baseline is None else Path(args.baseline)
        if args.baseline is not None and len(scenarios) > 1:
            folder /= scenario.name
        asked = args.baseline is not None or args.save or scenario.regression is not None
        compared = asked or args.require_baseline or not scenario.thresholds or folder.is_dir()
        found.append(load_target(scenario, folder, compared, args.accept_changes))
        if args.require_baseline and found[-1].baseline is None:
            text = f"{folder}: there is no baseline of {scenario.name!r}"
            raise UsageError(text, "check the folder, or save a baseline with --save and commit it")
    return found


def _machine(args: argparse.Namespace) -> Any:
    from avrare.analysis.check.targets import ExecutionSettings
    from avrare.report.terminal.progress_line import Progress

    return ExecutionSettings(args.workers, args.executor, partial(Progress, mode=display(args)))


def _plan(args: argparse.Namespace, subjects: Sequence[Any], budget: Any) -> int:
    from avrare.analysis.check.baseline import BaselineEntry
    from avrare.analysis.check.power_analysis import estimate_costs
    from avrare.report.terminal.check_table import print_plan

    found = []
    for one in subjects:
        known, source = {}, "the baseline"
        if one.baseline is not None and budget is None:
            entries = one.baseline.entries
            known = {name: entries[name] for name in one.definition.estimated if name in entries}
        if not known:
            pilot = _pilot(one, budget, _machine(args))
            known = {result.specification: BaselineEntry.from_result(result) for result in pilot}
            source = f"a pilot run of {max(entry.rollouts for entry in known.values()):,}"
        scenario = one.definition
        found += estimate_costs(scenario.name, one.planned_criteria, known, source, scenario.confidence)
    if args.json:
        print(json.dumps({"schema": 1, "plan": [vars(one) for one in found]}))
    else:
        print_plan(found, display(args))
    return int(ExitCode.PASS)


def _pilot(one: Any, budget: Any, machine: Any) -> list[Any]:
    """Run a first estimate: short for Monte Carlo, otherwise as the scenario says."""
    from avrare.analysis.check.targets import Look, estimate_look
    from avrare.estimation.budget import Budget

    estimator = one.definition.estimator
    if budget is None and estimator.plugin == "mc":
        runs = estimator.config.runs
        budget = Budget("rollouts", max(runs, min(_PILOT_ROLLOUTS, estimator.config.most * runs)))
    return estimate_look(one.scenario, one.definition.estimated, Look(1, 1.0, budget), machine)


def _make_folders(args: argparse.Namespace) -> None:
    from avrare.base.files import ensure_writable

    for option, name in (("--junit", args.junit), ("--markdown", args.markdown)):
        if name and Path(name).is_dir():
            raise UsageError(f"{name}: is a folder, not a file", f"choose another {option}")
        if name:
            ensure_writable(Path(name).parent, option)
    if args.out:
        ensure_writable(Path(args.out), "--out")


def _write(args: argparse.Namespace, subjects: Sequence[Any], outcome: Any) -> None:
    from avrare.base.files import write_text
    from avrare.report.documents.check_documents import junit, markdown
    from avrare.results import run_folder as rundir

    for name, text in ((args.junit, junit), (args.markdown, markdown)):
        if name is not None:
            with write_errors(name, "choose another file"):
                write_text(Path(name), text(outcome))
    if args.out:
        write_files(Path(args.out), {"check.json": json.dumps(outcome.to_dict(subjects), indent=2) + "\n"})
    for one in subjects if args.out else ():
        results = outcome.results[one.definition.name]
        folder = rundir.choose(args.out, one.definition.name, len(subjects) > 1)
        rundir.write(folder, one.definition, rundir.document(one.definition, results), results)
