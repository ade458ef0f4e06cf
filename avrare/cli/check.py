"""``avrare check``: thresholds, baselines and the rates of a catalogue, turned into an exit code."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from avrare.analysis.check.check import choose_catalogue, decide_rates
from avrare.analysis.check.gate import CheckResult, check_targets
from avrare.analysis.check.next_steps import with_next_steps
from avrare.analysis.check.power_analysis import estimate_costs
from avrare.analysis.check.targets import (
    CheckTarget,
    Look,
    estimate_look,
    load_targets,
    plan_check,
)
from avrare.base.atomic_files import ensure_writable
from avrare.base.errors import ExitCode, Interrupted, UsageError
from avrare.base.stored_files import read_json
from avrare.cli import rate
from avrare.cli.options import display, overrides
from avrare.cli.output import (
    UNFINISHED,
    ensure_files,
    find_resumed_folder,
    print_warnings,
    refuse_overwrite,
    say,
    write_file,
    write_files,
)
from avrare.estimation.choice.auto_config import AutoConfig
from avrare.estimation.combine.specifications import Execution
from avrare.estimation.loop.checkpoint import Checkpoint, resume_hint
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.result import Result
from avrare.output.documents import annotate_rows, is_github_job, junit, markdown, write_summary
from avrare.output.terminal.check_table import print_check, print_plan
from avrare.output.terminal.progress_line import Progress
from avrare.results import run_folder as rundir
from avrare.results.run import Run
from avrare.results.run_folder import call_back
from avrare.rollout.executors.interruption import Stopping
from avrare.rollout.executors.work import build_executor
from avrare.scenario.load import is_catalogue, load_scenarios

_CHECK = "check.json"


def execute(args: argparse.Namespace) -> int:
    """Check the scenarios together, or a catalogue; report, and return the exit code of the verdict."""
    if any(map(is_catalogue, args.scenarios)):
        return _check_catalogue(args)
    budget = Budget.parse(args.budget)
    out = _out_folder(args)
    _make_folders(args, out)
    targets = _load_targets(args)
    looks = plan_check(targets, budget, args.looks, args.save)
    names = [target.definition.name for target in targets]
    is_finished = out is not None and args.resume and _is_finished(out, names)
    if out and not args.plan and not is_finished:
        refuse_overwrite(out, _CHECK, names, args.resume)
    with _saved_chunks(args, targets, budget, looks) as saved:
        if out and is_finished:
            _begin_again(out)
        try:
            with Stopping() as stop:
                machine = _machine(args, stop, saved)
                if args.plan:
                    return _plan(args, targets, None if args.looks else budget, machine)
                outcome = check_targets(targets, looks, machine, args.save)
        except Interrupted:
            raise Interrupted(*_explain_interruption(saved)) from None
        outcome = replace(with_next_steps(outcome, targets, out), strict=args.strict)
        messages = _write(args, out, outcome)
        if saved is not None:
            saved.remove()
    say(*messages, error=args.json)
    if is_github_job():
        write_summary(outcome)
        for line in annotate_rows(outcome, {target.name: target.definition.path for target in targets}):
            print(line, file=sys.stderr if args.json else sys.stdout)
    if args.json:
        print(json.dumps(outcome.to_dict()))
    else:
        print_check(outcome, display(args))
    return int(outcome.exit_code)


def _out_folder(args: argparse.Namespace) -> Path | None:
    if not args.resume:
        return Path(args.out) if args.out else None
    if args.plan:
        raise UsageError("--resume cannot be combined with --plan", "a plan saves nothing")
    return find_resumed_folder(args)


def _is_finished(out: Path, names: Sequence[str]) -> bool:
    """Return whether a folder has the verdict of a check of these scenarios."""
    if not (out / _CHECK).exists():
        return False
    results = read_json(out / _CHECK, "choose another folder, or remove it").get("results")
    stored = results if isinstance(results, list) else []
    return [result.get("scenario") for result in stored if isinstance(result, dict)] == list(names)


def _begin_again(out: Path) -> None:
    """Take back a verdict: the code that is checked may have changed since."""
    say(f"{out}: this check is finished; it begins again, as the code may have changed", error=True)
    write_files(out, {UNFINISHED: "avrare check was writing here\n"})
    (out / _CHECK).unlink()


@contextmanager
def _saved_chunks(
    args: argparse.Namespace, targets: Sequence[CheckTarget], budget: Budget | None, looks: Sequence[Look]
) -> Iterator[Checkpoint | None]:
    """Open the checkpoint of ``--resume``; a check with another baseline or other looks is another one."""
    if not args.resume:
        yield None
        return
    baselines = {target.name: target.baseline.path.name if target.baseline else None for target in targets}
    identity = {"looks": len(looks), "baselines": baselines}
    scenarios = [target.definition for target in targets]
    with rundir.begin_checkpoint(Path(args.out), scenarios, budget, True, identity) as checkpoint:
        yield checkpoint


def _explain_interruption(saved: Checkpoint | None) -> tuple[str, str]:
    if saved is None:
        hint = "run the check again; with --out DIR --resume it saves finished work"
        return "interrupted before a verdict", hint
    count = saved.chunks
    progress = f"{count} {'chunk is' if count == 1 else 'chunks are'} saved"
    return f"interrupted before a verdict; {progress}", resume_hint(saved.folder.parent)


def _load_targets(args: argparse.Namespace) -> list[CheckTarget]:
    scenarios = load_scenarios(args.scenarios, overrides(args), args.estimator)
    for scenario in scenarios:
        print_warnings(scenario.warnings)
    return load_targets(
        scenarios, args.baseline, save=args.save, require=args.require_baseline, accept=args.accept_changes
    )


def _machine(args: argparse.Namespace, stop: Stopping, saved: Checkpoint | None) -> Execution:
    watch = partial(Progress, mode=display(args), stop=stop)
    execution = Execution(partial(build_executor, args.workers, args.executor), watch, stop=stop)
    return replace(execution, journal=saved.journal) if saved is not None else execution


def _plan(
    args: argparse.Namespace,
    targets: Sequence[CheckTarget],
    budget: Budget | None,
    machine: Execution,
) -> int:
    costs = []
    for target in targets:
        estimates, source = {}, "the baseline"
        if target.baseline is not None and budget is None:
            entries = target.baseline.entries
            estimates = {name: entries[name] for name in target.definition.estimated if name in entries}
        if not estimates:
            pilot = _pilot(target, budget, machine)
            estimates = {result.specification: result for result in pilot}
            source = f"a pilot run of {max(entry.rollouts for entry in estimates.values()):,}"
        scenario, limits = target.definition, target.find_limits() if budget is None else None
        costs += estimate_costs(
            scenario.name, target.planned_criteria, estimates, source, scenario.confidence, limits
        )
    if args.json:
        print(json.dumps({"schema": 1, "plan": [vars(target) for target in costs]}))
    else:
        print_plan(costs, display(args))
    return int(ExitCode.PASS)


def _pilot(target: CheckTarget, budget: Budget | None, machine: Execution) -> list[Result]:
    """Run a first estimate: short for Monte Carlo and auto, otherwise as the scenario says."""
    estimator = target.definition.estimator
    pilot_rollouts = 200
    if budget is None and isinstance(estimator.config, McConfig):
        runs = estimator.config.runs
        budget = Budget("rollouts", max(runs, min(pilot_rollouts, estimator.config.rollouts * runs)))
    elif budget is None and isinstance(estimator.config, AutoConfig):
        budget = Budget("rollouts", pilot_rollouts)
    return estimate_look(target.scenario, target.definition.estimated, Look(1, 1.0, budget), machine)


def _make_folders(args: argparse.Namespace, out: Path | None) -> None:
    ensure_files({"--junit": args.junit, "--markdown": args.markdown})
    if out:
        ensure_writable(out, "--out")


def _write(args: argparse.Namespace, out: Path | None, outcome: CheckResult) -> list[str]:
    """Write the files, and return the messages of the callbacks of plugins."""
    for name, text in ((args.junit, junit), (args.markdown, markdown)):
        if name is not None:
            write_file(name, text(outcome), "choose another file")
    if not out:
        return []
    messages: list[str] = []
    write_files(out, {UNFINISHED: "avrare check was writing here\n"})
    for target in outcome.targets:
        results = outcome.results[target.definition.name]
        folder = rundir.make_folder(out, target.definition.name, len(outcome.targets) > 1)
        run = Run.of_scenario(target.definition, results, Budget.parse(args.budget))
        messages += call_back(run.write(folder))
    write_files(out, {_CHECK: json.dumps(outcome.to_dict(), indent=2) + "\n"})
    (out / UNFINISHED).unlink()
    return messages


def _check_catalogue(args: argparse.Namespace) -> int:
    """Estimate the rates of the catalogue, report their verdicts, and return the exit code."""
    refused = (
        "set",
        "estimator",
        "seed",
        "looks",
        "plan",
        "baseline",
        "save",
        "require_baseline",
        "accept_changes",
    )
    catalogue = choose_catalogue(args.scenarios, **{name: getattr(args, name) for name in refused})
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
