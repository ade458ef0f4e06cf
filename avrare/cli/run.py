"""``avrare run``: estimate the failure probability of every specification of a scenario."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import signal
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from avrare.analysis.failures.storage import FailureDatabase
from avrare.analysis.failures.stored_replays import check_known_failures, store_worst
from avrare.base.errors import AvrareError, ExitCode, Interrupted, OutOfMemory, ScenarioError, UsageError
from avrare.base.number_format import format_confidence
from avrare.cli.options import display, overrides
from avrare.cli.output import can_draw, find_resumed_folder, print_warnings, say
from avrare.estimation.combine.specifications import Execution
from avrare.estimation.estimate import check_scenarios, estimate_scenario
from avrare.estimation.loop.checkpoint import Checkpoint, SaveError, resume_hint
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.result import Result
from avrare.estimation.result.verdict import with_verdict
from avrare.output.plots.rollout_plot import draw_run
from avrare.output.terminal.console import Mode, make_console, print_lines, print_table
from avrare.output.terminal.progress_line import Progress
from avrare.output.terminal.result_table import (
    note_lines,
    result_table,
    verdict_lines,
    warning_lines,
)
from avrare.plugin.registry import default_registry
from avrare.results import run_folder as rundir
from avrare.results.run import RESULT, Run
from avrare.results.run_folder import call_back
from avrare.rollout.child_process import SystemCrashed
from avrare.rollout.executors.interruption import Stopping
from avrare.rollout.executors.work import Executor, build_executor
from avrare.rollout.executors.worker_pool import WorkerDied
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.problem import Problem
from avrare.scenario.json_schema import scenario_schema
from avrare.scenario.load import load_scenarios
from avrare.scenario.schema import Scenario
from avrare.scenario.validation import UNKNOWN_KEY

_OPTIONS = {
    "seed": "--seed",
    "cross_check": "--cross-check",
    "estimator.learned": "--learned",
    "estimator.relative_error": "--until relative_error",
    "estimator.threshold": "--until threshold",
}
"""Keys of a scenario that an option sets, with the option."""


def execute(args: argparse.Namespace) -> int:
    """Run the scenarios one after another, or resume an interrupted run."""
    out = _out_folder(args)
    scenarios, budget = _named_scenarios(args), Budget.parse(args.budget)
    if args.resume:
        assert out is not None
        finished = rundir.read_finished(out, scenarios, _overrides(args), args.estimator, budget)
        if finished:
            say(f"{out}: this run is already finished", error=True)
            return _finish(args, finished)
        budget = budget or rundir.saved_budget(out)
        scenarios = scenarios or _load_interrupted_scenarios(args, out)
    for scenario in scenarios:
        print_warnings(scenario.warnings)
    built = [LoadedScenario(scenario) for scenario in scenarios]
    check_scenarios([(scenario, budget) for scenario in built])
    names = [scenario.name for scenario in scenarios]
    home = out or rundir.make_new_folder(names)
    try:
        rundir.make_folder(home, names[0], several=False)
        with rundir.begin_checkpoint(home, scenarios, budget, args.resume) as checkpoint:
            folders = [rundir.make_folder(home, name, len(scenarios) > 1) for name in names]
            for folder in folders:
                if (folder / RESULT).exists() and not args.resume:
                    say(f"{folder}: its results are replaced when this run is finished", error=True)
            with _explain_crash(
                f"hint: {resume_hint(home)} --executor processes: what crashes is an error there"
            ):
                runs = _run_all(zip(built, folders, strict=True), args, budget, checkpoint)
            checkpoint.remove()
    except AvrareError:
        if out is None:
            rundir.remove_empty(home)
        raise
    return _finish(args, runs)


@contextmanager
def _explain_crash(hint: str) -> Iterator[None]:
    """Have a child print a hint should this process end within the block, as by a crash of a simulator."""
    if sys.platform != "linux":
        yield
        return
    reader, writer = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on forks beside threads: the child only reads and writes
        child = os.fork()
    if not child:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        os.closerange(3, reader)  # locks of the run's folder
        os.closerange(max(reader, 2) + 1, os.sysconf("SC_OPEN_MAX"))
        if not os.read(reader, 1):
            os.write(2, f"the process of this run has ended, by a crash or from outside\n{hint}\n".encode())
        os._exit(0)
    os.close(reader)
    try:
        yield
    finally:
        with suppress(OSError):  # the child may have been killed, too
            os.write(writer, b".")
        os.close(writer)
        with suppress(OSError):
            os.waitpid(child, 0)


def _out_folder(args: argparse.Namespace) -> Path | None:
    if not args.resume:
        return None if args.out is None else Path(args.out)
    if args.out is not None and not args.scenarios and not Path(args.out).exists():
        hint = "give the folder of the interrupted run, or a SCENARIO to begin there"
        raise UsageError(f"--out {args.out}: no such folder", hint)
    return find_resumed_folder(args, begins=bool(args.scenarios))


def _named_scenarios(args: argparse.Namespace) -> list[Scenario]:
    if not args.scenarios and not args.resume:
        raise UsageError("avrare run: SCENARIO is required", "avrare run SCENARIO, or --out DIR --resume")
    try:
        return load_scenarios(args.scenarios, _overrides(args), args.estimator)
    except ScenarioError as error:
        problems = [_by_option(text, hint, args) for text, hint in error.problems]
        raise ScenarioError(problems, error.exit_code) from None


def _by_option(text: str, hint: str | None, args: argparse.Namespace) -> tuple[str, str | None]:
    # What an option has set is not told as a --set that nobody has written.
    written = {override.partition("=")[0].strip() for override in args.set}
    for key, option in _OPTIONS.items():
        if key not in written and text.startswith(f"--set {key}: "):
            reason = text.removeprefix(f"--set {key}: ")
            if reason.startswith(UNKNOWN_KEY):
                names = _find_estimators(key.removeprefix("estimator."))
                text = f"{option}: the scenario's estimator has no such option"
                return text, f"add --estimator with one of {names}"
            return f"{option}: {reason}", hint
    return text, hint


def _find_estimators(option: str) -> str:
    """Return the names of the installed estimators that have this option."""
    choices = scenario_schema(default_registry())["properties"]["estimator"]["oneOf"]
    fields = [choice["properties"] for choice in choices]
    return ", ".join(each["plugin"]["const"] for each in fields if option in each)


def _load_interrupted_scenarios(args: argparse.Namespace, out: Path) -> list[Scenario]:
    scenarios = rundir.saved_scenarios(out, _overrides(args), args.estimator)
    if not scenarios:
        hint = f"avrare run SCENARIO --out {shlex.quote(str(out))} starts one"
        empty = all(path.is_dir() for path in out.rglob("*") if not path.name.startswith("."))
        reason = ": a run that was to begin here has saved nothing" if empty else ""
        raise UsageError(f"--out {out}: contains no interrupted run{reason}", hint)
    return scenarios


def _overrides(args: argparse.Namespace) -> list[str]:
    settings = [*overrides(args), *(["cross_check=true"] if args.cross_check else [])]
    if args.learned is not None:
        settings.append(f"estimator.learned={json.dumps(args.learned)}")
    if args.until is None:
        return settings
    key, _, value = args.until.partition("=")
    if key not in ("relative_error", "threshold") or not value:
        hint = "write --until relative_error=0.1 or --until threshold=1e-3"
        raise UsageError(f"--until {args.until!r} is invalid", hint)
    return [*settings, f"estimator.{key}={value}"]


def _run_all(
    pairs: Iterable[tuple[LoadedScenario, Path]],
    args: argparse.Namespace,
    budget: Budget | None,
    checkpoint: Checkpoint,
) -> list[Run]:
    try:
        with Stopping() as stop:
            return [_run_scenario(*pair, args, budget, checkpoint, stop) for pair in pairs]
    except (Interrupted, KeyboardInterrupt) as error:
        count = checkpoint.chunks
        message = f"interrupted, {count} {'chunk is' if count == 1 else 'chunks are'} saved"
        raise Interrupted(message, resume_hint(checkpoint.folder.parent)) from error
    except MemoryError:
        raise _add_checkpoint_hint(OutOfMemory(), checkpoint) from None
    except (SaveError, SystemCrashed, WorkerDied) as error:
        raise _add_checkpoint_hint(error, checkpoint) from error.__cause__


def _add_checkpoint_hint(error: AvrareError, checkpoint: Checkpoint) -> AvrareError:
    if checkpoint.chunks:
        error.hint = f"{error.hint}; completed chunks are saved: {resume_hint(checkpoint.folder.parent)}"
    return error


def _finish(args: argparse.Namespace, runs: Sequence[Run]) -> int:
    if args.json:
        contents = [run.to_dict() for run in runs]
        print(json.dumps(contents[0] if len(contents) == 1 else contents))
    too_many_errors = any("errors" in result.health for run in runs for result in run.values())
    return int(ExitCode.ROLLOUT_ERRORS if too_many_errors else ExitCode.PASS)


def _run_scenario(
    scenario: LoadedScenario,
    folder: Path,
    args: argparse.Namespace,
    budget: Budget | None,
    checkpoint: Checkpoint,
    stop: Stopping,
) -> Run:
    definition = scenario.definition
    _use_failures(scenario, None, args)
    results = estimate_run(scenario, args, budget, checkpoint, stop)
    run = Run.of_scenario(definition, results, budget).write(folder)
    _use_failures(scenario, results, args)
    drawable = scenario.scene or scenario.stack.loop.simulator.junction
    draws = not args.no_pictures and drawable is not None and can_draw()
    pictures = draw_run(scenario, results, folder) if draws else []
    replies = call_back(run)
    with suppress(BrokenPipeError):  # `| head -1`: further scenarios still run, and no checkpoint stays
        if not args.json:
            _show(definition, results, folder, pictures, display(args))
        say(*replies, error=args.json)
    return run


def _use_failures(
    scenario: LoadedScenario, results: Sequence[Result] | None, args: argparse.Namespace
) -> None:
    """Replay the failures of ``--failures``, or store those of the results; print the outcome."""
    if args.failures is None:
        return
    database = FailureDatabase(Path(args.failures))
    if results is None:
        lines = check_known_failures(database, scenario)
    else:
        failures = {result.specification: result.failures for result in results}
        new, lines = store_worst(database, scenario, failures)
        if new:
            lines = [f"{len(new)} new failures in {args.failures}: {', '.join(new)}", *lines]
    with suppress(BrokenPipeError):
        say(*lines, error=args.json)


def estimate_run(
    scenario: LoadedScenario,
    args: argparse.Namespace,
    budget: Budget | None,
    checkpoint: Checkpoint,
    stop: Stopping,
) -> list[Result]:
    """Estimate a scenario with live lines and a journal; ``args`` has the options of ``avrare run``."""
    definition = scenario.definition
    confidence = definition.confidence if definition.estimator.plugin == "mc" else None
    journal = cache(lambda specification: checkpoint.journal(f"{definition.name}/{specification}"))
    executors: list[Executor] = []
    begun: set[str] = set()
    # What ended a run that goes on may have been a crash, which a worker process survives.
    default = "processes" if args.resume and checkpoint.chunks else None

    def start_executor() -> Executor:
        executors.append(build_executor(args.workers, args.executor or default))
        return executors[-1]

    @contextmanager
    def watch(label: str, problem: Problem) -> Iterator[Progress]:
        with Progress(label, problem, display(args), confidence, stop) as progress:
            if problem.names[0] not in begun:  # a cross-check comes second
                progress.resume(journal(problem.names[0]).seconds)
            begun.add(problem.names[0])
            yield progress
        _report_restarts(executors[-1])

    execution = Execution(start_executor, watch, journal, stop)
    results = estimate_scenario(scenario, definition.estimated, budget, execution)
    return [with_verdict(result, definition.thresholds) for result in results]


def _report_restarts(executor: Executor) -> None:
    if executor.restarts:  # no part of any result: the chunks gave the same bits the second time
        say(f"note: workers died: {executor.restarts}; their chunks were run again", error=True)


def _show(
    definition: Scenario, results: Sequence[Result], folder: Path, pictures: Sequence[Path], mode: Mode
) -> None:
    if mode == "quiet":
        say(*verdict_lines(definition.name, results))
        return
    console = make_console(mode)
    confidence = format_confidence(definition.confidence)
    settings = f"{definition.estimator.plugin}, seed {definition.seed}, {confidence} intervals"
    title = f"{definition.name}  {settings}"
    print_table(console, result_table(title, results))
    print_lines(console, warning_lines(results), "yellow")
    print_lines(console, note_lines(results))
    command = shlex.join(["avrare", "report", str(folder), "--open"])
    print_lines(
        console,
        [f"results in {folder}; to look at them: {command}", *(f"  {path.name}" for path in pictures)],
    )
