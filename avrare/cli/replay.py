"""``avrare replay``: run a stored failure again and report whether it still fails."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from avrare.analysis.causes.first_violation import find_first_violation
from avrare.analysis.failures.failure import Failure, make_failure, record_failure
from avrare.analysis.failures.noise_free_continuation import continue_without_noise
from avrare.analysis.failures.shrink import BUDGET, shrink
from avrare.analysis.failures.storage import decode
from avrare.analysis.failures.stored_replays import FailureReplay, replay, replay_error
from avrare.base.errors import ExitCode, UsageError
from avrare.cli.failure_output import describe_shrinking, progress_line, store_failure
from avrare.cli.output import print_notes, print_warnings, show
from avrare.plugin.provided import load_function
from avrare.results.run import Run
from avrare.rollout.loaded_scenario import LoadedScenario


def execute(args: argparse.Namespace) -> int:
    """Replay, and with ``--shrink`` shrink; return exit code 0 if it fails again, 1 if not."""
    _check(args)
    replay = _replay_failure_of_run(args) if args.run is not None else _replay_stored_failure(args)
    scenario, failure = replay.scenario, replay.failure
    show(args, replay.table()[0], [replay])
    _export(args, replay)
    if replay.rollout.outcome == "error":
        return int(ExitCode.ROLLOUT_ERRORS)
    if replay.rollout.outcome == "passes":
        return int(ExitCode.FAIL)
    problem = scenario.problem(failure.specification)
    first = find_first_violation(problem, replay.rollout)
    if first.severity is not None:
        print_notes(args, f"the {first.severity.describe()}")
    if args.lost:
        sample = first.sample if first.sample >= 0 else None
        print_notes(args, continue_without_noise(problem, failure.noise).describe(sample))
    if args.shrink:
        _shrink(args, scenario, failure)
    elif args.write_blob is not None:
        store_failure(args, make_failure(scenario, failure.specification, failure.noise, replay.rollout))
    return int(ExitCode.PASS)


def _check(args: argparse.Namespace) -> None:
    if args.run is None:
        if args.scenario is None:
            raise UsageError("avrare replay: SCENARIO is required", "avrare replay SCENARIO --failure ID")
        if (args.failure is None) == (args.blob is None):
            text = "name one failure: --failure, --blob or --run"
            raise UsageError(text, "avrare replay SCENARIO --failure ID")
        if args.error is not None:
            raise UsageError("--error requires --run", "avrare replay --run DIR --error 0")
        if args.specification is not None:
            raise UsageError("--specification requires --run", "a stored failure names its specification")
    elif args.blob is not None:
        raise UsageError("--blob cannot be combined with --run", "give one of them")
    if "" in args.export:
        raise UsageError("--export must be a file, not ''")
    if args.export:
        load_function("export")  # before the replay, where its distribution is missing


def _replay_stored_failure(args: argparse.Namespace) -> FailureReplay:
    failure = args.failure if args.blob is None else decode(_blob(args.blob))
    return replay(args.scenario, failure, overrides=args.set, failures=args.failures)


def _blob(text: str) -> str:
    if not text.startswith("@"):
        return text
    if text == "@-":
        return sys.stdin.read()
    try:
        return Path(text[1:]).read_text(encoding="ascii")
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or "not a text file"
        raise UsageError(f"{text[1:]}: cannot be read: {reason}", "give --blob @FILE") from None


def _replay_failure_of_run(args: argparse.Namespace) -> FailureReplay:
    if args.failure is not None and not args.failure.isdecimal():
        raise UsageError(f"--failure {args.failure}: with --run, give the index of a failure, from 0")
    index = None if args.failure is None else int(args.failure)
    run = Run.read(args.run)
    print_warnings((line, None) for line in run.changes)
    if args.error is not None:
        return replay_error(run, args.error, args.specification)
    return replay(run, index, args.specification, scenario=args.scenario, overrides=args.set)


def _export(args: argparse.Namespace, replay: FailureReplay) -> None:
    for path in args.export:
        print_notes(args, f"written to {path}", *load_function("export")(replay, path))


def _shrink(args: argparse.Namespace, scenario: LoadedScenario, failure: Failure) -> None:
    budget = BUDGET if args.budget is None else args.budget
    problem = scenario.problem(failure.specification)
    with progress_line(args) as progress:
        small = shrink(problem, failure.noise, budget, progress)
    print_notes(args, *describe_shrinking(problem, small))
    store_failure(args, record_failure(scenario, failure.specification, small.noise))
