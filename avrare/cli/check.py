"""``avrare check``: thresholds and baselines, turned into an exit code."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from avrare.cli.doubts import warn
from avrare.cli.former import refuse_former
from avrare.cli.parser import add_display_arguments, add_scenario_arguments, display
from avrare.errors import ExitCode, UsageError

_EXAMPLE = """\
A threshold passes once its interval lies below the bound and fails once it lies above.
A rule is compared with the newest baseline, a numbered file in baselines/NAME next to
the scenario, where there is one; the first run saves it. docs/ci.md says more.

examples:
  avrare check scenarios/*.yaml --junit report.xml --markdown summary.md
  avrare check drive.yaml --spend rollouts=80000    # up to four looks, until all is clear
  avrare check drive.yaml --plan                    # what a verdict will cost
  avrare check drive.yaml --save                    # a new baseline

exit code: 0 all pass, 1 a row fails, 3 inconclusive, 4 bad scenario or usage,
5 plugin missing, 6 too many rollouts broke down
"""
_PILOT = 200
"""Monte Carlo rollouts of a pilot run."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``avrare check``."""
    parser.epilog = _EXAMPLE
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add_scenario_arguments(parser)
    parser.add_argument("--seed", type=int, metavar="N", help="the scenario's by default")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument("--executor", metavar="NAME", help="default: processes if workers > 1")
    parser.add_argument("--budget", metavar="KIND=N", help="steps=N, rollouts=N or seconds=N, each estimate")
    parser.add_argument(
        "--spend", metavar="KIND=N", help="the same, but in up to four looks until every verdict is clear"
    )
    folder = parser.add_argument_group("baselines")
    folder.add_argument(
        "--baseline", metavar="DIR", help="their folder (DIR/NAME for several scenarios); compare in any case"
    )
    folder.add_argument("--save", action="store_true", help="save this run as the new baseline")
    folder.add_argument(
        "--require-baseline", action="store_true", help="refuse to begin where there is none, as CI should"
    )
    folder.add_argument(
        "--accept-changes", action="store_true", help="compare even if the baseline answers another question"
    )
    output = parser.add_argument_group("output")
    output.add_argument("--plan", action="store_true", help="only tell what a verdict will cost")
    output.add_argument("--junit", metavar="FILE", help="write JUnit XML")
    output.add_argument("--markdown", metavar="FILE", help="write a summary for a merge request")
    output.add_argument("--out", metavar="DIR", help="write check.json and the run folders")
    output.add_argument("--json", action="store_true", help="print check.json and nothing else on stdout")
    add_display_arguments(parser)


def execute(args: argparse.Namespace) -> int:
    """Check the scenarios together, show, write, and exit with the verdict."""
    from avrare.check.looks import stages
    from avrare.estimation.budget import Budget

    if args.workers < 1:
        raise UsageError(f"--workers must be at least 1, not {args.workers}")
    budget, spend = Budget.parse(args.budget), Budget.parse(args.spend)
    if budget and spend:
        raise UsageError("--budget and --spend both say what it may cost", "leave one of them away")
    _make_folders(args)
    subjects = _subjects(args)
    if args.out and not args.plan:
        refuse_former(Path(args.out), "check.json", [one.definition.name for one in subjects])
    if args.plan:
        return _plan(args, subjects, budget)
    from avrare.check.gate import check

    outcome = check(subjects, stages(budget, spend), _machine(args), args.save)
    _write(args, subjects, outcome)
    if args.json:
        print(json.dumps(outcome.to_dict(subjects)))
    else:
        from avrare.check.screen import show

        show(outcome, display(args))
    return int(outcome.exit_code)


def _subjects(args: argparse.Namespace) -> list[Any]:
    """The scenarios with their baselines; nothing has run yet."""
    from avrare.check.subjects import subject
    from avrare.scenario.load import load

    seed = [f"seed={args.seed}"] if args.seed is not None else []
    scenarios = [load(path, [*args.set, *seed], args.estimator) for path in args.scenarios]
    names = [scenario.name for scenario in scenarios]
    if len(set(names)) < len(names):
        text = f"two scenarios have the same name: {', '.join(sorted(names))}"
        raise UsageError(text, "check them one at a time")
    for scenario in scenarios:
        warn(scenario.warnings)
    found = []
    for scenario in scenarios:
        folder = _folder(args, scenario, len(scenarios) > 1)
        asked = args.baseline is not None or args.save or scenario.regression is not None
        compared = asked or args.require_baseline or not scenario.thresholds or folder.is_dir()
        found.append(subject(scenario, folder, compared, args.accept_changes))
        if args.require_baseline and found[-1].baseline is None:
            raise UsageError(
                f"{folder}: there is no baseline of {scenario.name!r}",
                "is the folder right? else make one with --save and commit it",
            )
    return found


def _folder(args: argparse.Namespace, scenario: Any, several: bool) -> Path:
    from avrare.check.baseline import default_folder

    if args.baseline is None:
        return default_folder(scenario)
    return Path(args.baseline) / scenario.name if several else Path(args.baseline)


def _machine(args: argparse.Namespace) -> Any:
    from avrare.check.subjects import Machine
    from avrare.report.console import Progress

    return Machine(args.workers, args.executor, partial(Progress, mode=display(args)))


def _plan(args: argparse.Namespace, subjects: Sequence[Any], budget: Any) -> int:
    from avrare.check.baseline import Entry
    from avrare.check.planner import plan

    found = []
    for one in subjects:
        known, source = {}, "the baseline"
        if one.baseline is not None and budget is None:
            known = {rule: one.baseline.entries[rule] for rule in one.definition.estimated
                     if rule in one.baseline.entries}  # fmt: skip
        if not known:
            pilot = _pilot(one, budget, _machine(args))
            known = {result.specification: Entry.of(result) for result in pilot}
            source = f"a pilot run of {max(entry.rollouts for entry in known.values()):,}"
        found += plan(one.definition.name, one.planned, known, source, one.definition.confidence)
    if args.json:
        print(json.dumps({"schema": 1, "plan": [one.to_dict() for one in found]}))
    else:
        from avrare.check.screen import show_plan

        show_plan(found, display(args))
    return int(ExitCode.PASS)


def _pilot(one: Any, budget: Any, machine: Any) -> list[Any]:
    """A first estimate: short where the estimator is Monte Carlo, else as the scenario asks for."""
    from avrare.check.looks import Stage
    from avrare.check.subjects import estimate
    from avrare.estimation.budget import Budget

    config = one.definition.estimator.config
    if budget is None and one.definition.estimator.plugin == "mc":
        budget = Budget("rollouts", max(config.runs, min(_PILOT, config.most * config.runs)))
    return estimate(one.scenario, one.definition.estimated, Stage(1, 1.0, budget), machine)


def _make_folders(args: argparse.Namespace) -> None:
    """Before anything runs: what cannot be written at the end is best known now."""
    folders = [Path(name).parent for name in (args.junit, args.markdown) if name]
    for folder in [*folders, *([Path(args.out)] if args.out else [])]:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"{folder}: cannot make this folder: {error.strerror}") from None
        if not os.access(folder, os.W_OK):
            raise UsageError(f"{folder}: cannot write into this folder", "choose another place")
    for name in (args.junit, args.markdown):
        if name and Path(name).is_dir():
            raise UsageError(f"{name}: is a folder, not a file to write", "choose another place")


def _write(args: argparse.Namespace, subjects: Sequence[Any], outcome: Any) -> None:
    from avrare.check.document import junit, markdown
    from avrare.record import rundir
    from avrare.record.whole import write_text

    texts = {args.junit: junit, args.markdown: markdown}
    texts.pop(None, None)
    try:
        for name, text in texts.items():
            write_text(Path(name), text(outcome))
        if args.out:
            content = json.dumps(outcome.to_dict(subjects), indent=2) + "\n"
            write_text(Path(args.out) / "check.json", content)
    except OSError as error:
        raise UsageError(
            f"{error.filename}: cannot write: {error.strerror}", "choose another place"
        ) from None
    for one in subjects if args.out else ():
        results = outcome.results[one.definition.name]
        folder = rundir.choose(args.out, one.definition.name, len(subjects) > 1)
        rundir.write(folder, one.definition, rundir.document(one.definition, results), results)
