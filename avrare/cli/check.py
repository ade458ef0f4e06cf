"""``avrare check``: thresholds and baselines, turned into an exit code."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from avrare.analysis.check.baseline_files import BaselineEntry, default_folder
from avrare.analysis.check.finished_check import CHECK, describe_settings, read_finished, to_content
from avrare.analysis.check.gate import CheckResult, check
from avrare.analysis.check.next_steps import with_next_steps
from avrare.analysis.check.power_analysis import estimate_costs
from avrare.analysis.check.targets import ExecutionSettings, Look, estimate_look, load_target, plan_looks
from avrare.analysis.rates.catalogue import is_catalogue
from avrare.base.atomic_files import ensure_writable
from avrare.base.errors import ExitCode, Interrupted, UsageError
from avrare.cli import check_catalogue
from avrare.cli.options import display, load_scenarios, overrides
from avrare.cli.output import (
    UNFINISHED,
    ensure_files,
    print_warnings,
    refuse_overwrite,
    resumed_folder,
    say,
    write_file,
    write_files,
)
from avrare.estimation.budget import Budget
from avrare.estimation.checkpoint import Checkpoint, resume_hint
from avrare.report.documents.check_documents import junit, markdown
from avrare.report.documents.github_output import annotate_rows, is_github_job, write_summary
from avrare.report.terminal.check_table import print_check, print_plan
from avrare.report.terminal.progress_line import Progress
from avrare.results import run_folder as rundir
from avrare.results.callbacks import call_back
from avrare.rollout.executors.interruption import Stopping
from avrare.scenario.safe_mode import refuse_outside

_PILOT_ROLLOUTS = 200


def execute(args: argparse.Namespace) -> int:
    """Check the scenarios together, or a catalogue; report, and return the exit code of the verdict."""
    if any(map(is_catalogue, args.scenarios)):
        return check_catalogue.execute(args)
    budget, spend = Budget.parse(args.budget), Budget.parse(args.spend)
    if budget and spend:
        raise UsageError("--budget cannot be combined with --spend", "remove one of them")
    out = _out_folder(args)
    _make_folders(args, out)
    subjects = _subjects(args)
    if args.plan:
        with _stopping(None) as stop:
            return _plan(args, subjects, budget, _machine(args, stop, None))
    settings = describe_settings(
        subjects, budget or spend, len(plan_looks(budget, spend)),
        save=args.save, accept_changes=args.accept_changes,
    )  # fmt: skip
    found = _read_finished(args, out, subjects, settings)
    outcome, content = found or _run(args, out, subjects, (budget, spend), settings)
    if is_github_job():
        write_summary(outcome)
        for line in annotate_rows(outcome, {one.name: one.definition.path for one in subjects}):
            print(line, file=sys.stderr if args.json else sys.stdout)
    if args.json:
        print(json.dumps(content))
    else:
        print_check(outcome, display(args))
    return int(outcome.exit_code)


def _read_finished(
    args: argparse.Namespace, out: Path | None, subjects: Sequence[Any], settings: dict[str, Any]
) -> tuple[CheckResult, dict[str, Any]] | None:
    """Read the finished check in the folder of ``--resume``, if there is one, and write its documents."""
    if out is None or args.resume is None or (out / UNFINISHED).exists():
        return None
    found = read_finished(out, subjects, settings)
    if found is not None:
        say(f"{out}: this check is already finished", error=True)
        _write_documents(args, found[0])
    return found


def _run(
    args: argparse.Namespace, out: Path | None, subjects: Sequence[Any],
    budgets: tuple[Budget | None, Budget | None], settings: dict[str, Any],
) -> tuple[CheckResult, dict[str, Any]]:  # fmt: skip
    if out is not None:
        names = [one.definition.name for one in subjects]
        refuse_overwrite(out, CHECK, names, args.resume is not None)
    with _saved_chunks(args, subjects, budgets[0] or budgets[1], settings) as saved:
        with _stopping(saved) as stop:
            machine = _machine(args, stop, saved)
            outcome = check(subjects, plan_looks(*budgets), machine, args.save)
        outcome = with_next_steps(outcome, subjects, out)
        content = to_content(outcome, subjects, settings)
        told = _write(args, out, subjects, outcome, content)
        if saved is not None:
            saved.remove()
    say(*told, error=args.json)
    return outcome, content


def _out_folder(args: argparse.Namespace) -> Path | None:
    if args.resume is None:
        return Path(args.out) if args.out else None
    if args.plan:
        raise UsageError("--resume cannot be combined with --plan", "a plan saves nothing")
    return resumed_folder(args)


@contextmanager
def _saved_chunks(
    args: argparse.Namespace, subjects: Sequence[Any], budget: Budget | None, settings: dict[str, Any]
) -> Iterator[Checkpoint | None]:
    """Open the checkpoint of ``--resume``; a check with another baseline or other looks is another one."""
    if args.resume is None:
        yield None
        return
    identity = {key: settings[key] for key in ("looks", "baselines")}
    scenarios = [one.definition for one in subjects]
    with rundir.begin_checkpoint(Path(args.resume), scenarios, budget, True, identity) as checkpoint:
        yield checkpoint


@contextmanager
def _stopping(saved: Checkpoint | None) -> Iterator[Stopping]:
    try:
        with Stopping() as stop:
            yield stop
    except Interrupted:
        raise Interrupted(*_explain_interruption(saved)) from None


def _explain_interruption(saved: Checkpoint | None) -> tuple[str, str]:
    if saved is None:
        hint = "run the check again; --resume DIR in place of --out DIR saves finished work"
        return "interrupted, there is no verdict", hint
    count = saved.chunks
    kept = f"{count} {'chunk is' if count == 1 else 'chunks are'} saved"
    return f"interrupted, there is no verdict; {kept}", resume_hint(saved.folder.parent)


def _subjects(args: argparse.Namespace) -> list[Any]:
    scenarios = load_scenarios(args, overrides(args))
    for scenario in scenarios:
        print_warnings(scenario.warnings)
    found = []
    for scenario in scenarios:
        folder = default_folder(scenario) if args.baseline is None else Path(args.baseline)
        if args.baseline is None:
            refuse_outside(folder, Path(scenario.path).parent, "the baseline folder")
        if args.baseline is not None and len(scenarios) > 1:
            folder /= scenario.name
        asked = args.baseline is not None or args.save or scenario.regression is not None
        compared = asked or args.require_baseline or not scenario.thresholds or folder.is_dir()
        found.append(load_target(scenario, folder, compared, args.accept_changes))
        if args.require_baseline and found[-1].baseline is None:
            text = f"{folder}: there is no baseline of {scenario.name!r}"
            raise UsageError(text, "check the folder, or save a baseline with --save and commit it")
    return found


def _machine(args: argparse.Namespace, stop: Stopping, saved: Checkpoint | None) -> ExecutionSettings:
    watch = partial(Progress, mode=display(args), stop=stop)
    return ExecutionSettings(args.workers, args.executor, watch, stop, saved.journal if saved else None)


def _plan(args: argparse.Namespace, subjects: Sequence[Any], budget: Any, machine: ExecutionSettings) -> int:
    found = []
    for one in subjects:
        known, source = {}, "the baseline"
        if one.baseline is not None and budget is None:
            entries = one.baseline.entries
            known = {name: entries[name] for name in one.definition.estimated if name in entries}
        if not known:
            pilot = _pilot(one, budget, machine)
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
    """Run a first estimate: short for Monte Carlo and auto, otherwise as the scenario says."""
    estimator = one.definition.estimator
    if budget is None and estimator.plugin == "mc":
        runs = estimator.config.runs
        budget = Budget("rollouts", max(runs, min(_PILOT_ROLLOUTS, estimator.config.rollouts * runs)))
    elif budget is None and estimator.plugin == "auto":
        budget = Budget("rollouts", _PILOT_ROLLOUTS)
    return estimate_look(one.scenario, one.definition.estimated, Look(1, 1.0, budget), machine)


def _make_folders(args: argparse.Namespace, out: Path | None) -> None:
    ensure_files({"--junit": args.junit, "--markdown": args.markdown})
    if out:
        ensure_writable(out, "--out" if args.resume is None else "--resume")


def _write_documents(args: argparse.Namespace, outcome: CheckResult) -> None:
    for name, text in ((args.junit, junit), (args.markdown, markdown)):
        if name is not None:
            write_file(name, text(outcome), "choose another file")


def _write(
    args: argparse.Namespace, out: Path | None, subjects: Sequence[Any], outcome: CheckResult,
    content: dict[str, Any],
) -> list[str]:  # fmt: skip
    """Write the files, and return what the callbacks of plugins say."""
    _write_documents(args, outcome)
    if not out:
        return []
    told: list[str] = []
    write_files(out, {UNFINISHED: "avrare check was writing here\n"})
    for one in subjects:
        results = outcome.results[one.definition.name]
        folder = rundir.choose(out, one.definition.name, len(subjects) > 1)
        rundir.write(folder, one.definition, rundir.document(one.definition, results), results)
        told += call_back(folder)
    write_files(out, {CHECK: json.dumps(content, indent=2) + "\n"})
    (out / UNFINISHED).unlink()
    return told
