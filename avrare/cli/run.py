"""``avrare run``: estimate the failure probability of every specification of a scenario."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from avrare.cli.doubts import warn
from avrare.cli.parser import add_display_arguments, add_scenario_arguments, display
from avrare.errors import AvrareError, ExitCode, Interrupted, UsageError
from avrare.scenario.schema import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``avrare run``."""
    add_scenario_arguments(parser, optional=True)
    parser.add_argument(
        "--seed", type=int, metavar="N", help="seed of all random numbers; the scenario's by default"
    )
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument(
        "--executor",
        metavar="NAME",
        help="where the work runs: serial, processes, ray (with options: ray,address=auto); default: "
        "processes if workers > 1",
    )
    parser.add_argument(
        "--budget", metavar="KIND=N", help="steps=N, rollouts=N or seconds=N, for each estimate"
    )
    parser.add_argument(
        "--until",
        metavar="relative_error=X|threshold=X",
        help="run Monte Carlo until the estimate is as exact as that, or known to lie below or above that",
    )
    parser.add_argument("--out", metavar="DIR", help="folder of the results; default: a new one under runs/")
    parser.add_argument(
        "--resume", metavar="DIR", help="go on with the run that was interrupted in this folder"
    )
    parser.add_argument(
        "--failures", metavar="DIR", help="drive the failures stored there first, and store new ones there"
    )
    parser.add_argument("--json", action="store_true", help="print result.json and nothing else on stdout")
    parser.add_argument("--no-pictures", action="store_true", help="draw nothing")
    add_display_arguments(parser)


def execute(args: argparse.Namespace) -> int:
    """Run the scenarios one after another, or go on where they were interrupted."""
    from avrare.estimation.budget import Budget
    from avrare.record import checkpoint_run, rundir

    if args.workers < 1:
        raise UsageError(f"--workers must be at least 1, not {args.workers}")
    out = _out(args)
    scenarios, budget = _scenarios(args), Budget.parse(args.budget)
    if args.resume is not None:
        assert out is not None
        contents = checkpoint_run.finished_results(out, scenarios, _overrides(args), args.estimator, budget)
        if contents:
            print(f"{out}: this run is finished", file=sys.stderr)
            return _ended(args, contents)
        budget = budget or checkpoint_run.saved_budget(out)
        scenarios = scenarios or _saved(args, out)
    for scenario in scenarios:
        warn(scenario.warnings)
    built = _built(scenarios, budget)
    names = [scenario.name for scenario in scenarios]
    home = out or rundir.fresh(names)
    try:
        folders = [rundir.choose(home, name, len(scenarios) > 1) for name in names]
        with checkpoint_run.begin(home, scenarios, budget, args.resume is not None) as checkpoint:
            contents = _run_all(zip(built, folders, strict=True), args, budget, checkpoint)
            checkpoint.remove()
    except AvrareError:
        if out is None:
            rundir.remove_empty(home)
        raise
    return _ended(args, contents)


def _out(args: argparse.Namespace) -> Path | None:
    """The folder that ``--out`` or ``--resume`` names."""
    if args.resume is None:
        return None if args.out is None else Path(args.out)
    if args.out is not None and Path(args.out).resolve() != Path(args.resume).resolve():
        raise UsageError("--resume goes on in the folder of the run: leave --out away")
    if not Path(args.resume).is_dir():
        raise UsageError(f"--resume {args.resume}: there is no such folder")
    return Path(args.resume)


def _scenarios(args: argparse.Namespace) -> list[Scenario]:
    """Those named on the command line."""
    from avrare.scenario.load import load

    if not args.scenarios and args.resume is None:
        raise UsageError("avrare run: the scenario is missing", "avrare run SCENARIO, or --resume DIR")
    scenarios = [load(path, _overrides(args), args.estimator) for path in args.scenarios]
    names = [scenario.name for scenario in scenarios]
    if len(set(names)) < len(names):
        raise UsageError(
            f"two scenarios have the same name: {', '.join(sorted(names))}", "run them one at a time"
        )
    return scenarios


def _saved(args: argparse.Namespace, out: Path) -> list[Scenario]:
    """Those of the run that is gone on with."""
    from avrare.record.checkpoint_run import saved_scenarios

    scenarios = saved_scenarios(out, _overrides(args), args.estimator)
    if not scenarios:
        raise UsageError(
            f"--resume {out}: no interrupted run is here", f"avrare run SCENARIO --resume {out} starts one"
        )
    return scenarios


def _built(scenarios: Sequence[Scenario], budget: Any) -> list[Any]:
    """Ready to be run; what would be found out only after hours is asked now."""
    from avrare.build.scenario import BuildableScenario
    from avrare.cli.foreseen import refuse_what_cannot_begin

    built = [BuildableScenario(scenario) for scenario in scenarios]
    for one in built if len(built) > 1 else ():
        refuse_what_cannot_begin(one, budget)
    return built


def _overrides(args: argparse.Namespace) -> list[str]:
    seed = [f"seed={args.seed}"] if args.seed is not None else []
    return [*args.set, *seed, *_until(args.until)]


def _run_all(
    pairs: Iterable[tuple[Any, Path]], args: argparse.Namespace, budget: Any, checkpoint: Any
) -> list[dict[str, Any]]:
    """The contents of all result.json; an interruption says how to go on."""
    from avrare.execute.stopping import Stopping
    from avrare.execute.window import WorkerDied
    from avrare.record.checkpoint import SaveError

    try:
        with Stopping() as stop:
            return [_run(scenario, folder, args, budget, checkpoint, stop) for scenario, folder in pairs]
    except (Interrupted, KeyboardInterrupt) as error:
        many = checkpoint.chunks
        message = f"interrupted, {many} {'chunk is' if many == 1 else 'chunks are'} saved"
        raise Interrupted(message, f"{_command(checkpoint)} goes on") from error
    except (SaveError, WorkerDied) as error:
        error.hint = f"{error.hint}; what is done is saved, {_command(checkpoint)} goes on"
        raise


def _command(checkpoint: Any) -> str:
    return shlex.join(["avrare", "run", "--resume", str(checkpoint.folder.parent)])


def _ended(args: argparse.Namespace, contents: list[dict[str, Any]]) -> int:
    if args.json:
        print(json.dumps(contents[0] if len(contents) == 1 else contents))
    troubled = any("errors" in entry["health"] for content in contents for entry in content["estimates"])
    return int(ExitCode.ROLLOUT_ERRORS if troubled else ExitCode.PASS)


def _until(text: str | None) -> list[str]:
    """The override that ``--until`` stands for."""
    if text is None:
        return []
    key, _, value = text.partition("=")
    if key not in ("relative_error", "threshold") or not value:
        raise UsageError(
            f"--until {text!r} is not understood",
            "write --until relative_error=0.1, or --until threshold=1e-3 to know on which side of it p lies",
        )
    return [f"estimator.{key}={value}"]


def _run(
    scenario: Any, folder: Path, args: argparse.Namespace, budget: Any, checkpoint: Any, stop: Any
) -> dict[str, Any]:
    from avrare.record import rundir

    definition = scenario.definition
    _drive_known(scenario, args)
    results = _estimates(scenario, args, budget, checkpoint, stop)
    content = rundir.document(definition, results)
    rundir.write(folder, definition, content, results, budget)
    _remember(scenario, results, args)
    pictures = [] if args.no_pictures else _draw(scenario, results, folder)
    if not args.json:
        _show(definition, results, folder, pictures, display(args))
    return content


def _drive_known(scenario: Any, args: argparse.Namespace) -> None:
    """Say how the failures of ``--failures`` come out now; no part of any result."""
    if args.failures is None:
        return
    from avrare.failures.database import Database
    from avrare.failures.known import known_lines

    for line in known_lines(Database(Path(args.failures)), scenario):
        print(line, file=sys.stderr if args.json else sys.stdout)


def _remember(scenario: Any, results: Sequence[Any], args: argparse.Namespace) -> None:
    if args.failures is None:
        return
    from avrare.failures.database import Database
    from avrare.failures.known import remember

    found = {result.specification: result.failures for result in results}
    new, complaints = remember(Database(Path(args.failures)), scenario, found)
    lines = [f"{len(new)} new failures in {args.failures}: {', '.join(new)}"] if new else []
    for line in [*lines, *complaints]:
        print(line, file=sys.stderr if args.json else sys.stdout)


def _estimates(scenario: Any, args: argparse.Namespace, budget: Any, checkpoint: Any, stop: Any) -> list[Any]:
    """One pass for all specifications where the estimator can, else one run for each."""
    from avrare.estimation.loop import Settings, run
    from avrare.report.console import Progress

    definition = scenario.definition
    estimator = scenario.estimator()
    groups = [(name,) for name in definition.estimated] if estimator.single else [definition.estimated]
    settings = Settings(
        definition.seed, definition.confidence, budget, definition.max_error_rate, definition.suppress,
        replay=True,
    )  # fmt: skip
    results = []
    for group in groups:
        problem = scenario.problem(group)
        label = group[0] if len(group) == 1 else f"{definition.name} ({len(group)} specifications)"
        journal = checkpoint.journal(f"{definition.name}/{group[0]}")
        executor = _executor(args)
        counted = definition.confidence if estimator.name == "mc" else None
        with Progress(f"{label}  {estimator.name}", problem, display(args), counted, stop) as progress:
            progress.began -= journal.seconds
            results += run(problem, estimator, executor, settings, progress, journal, stop)
        _tell_restarts(executor)
    return [_judged(definition, result) for result in results]


def _tell_restarts(executor: Any) -> None:
    """No part of any result: the chunks gave the same bits the second time."""
    restarts = getattr(executor, "restarts", 0)
    if restarts:
        print(f"note: workers died {restarts} time(s); their chunks were run again", file=sys.stderr)


def _judged(definition: Scenario, result: Any) -> Any:
    """With the verdict of the scenario's thresholds; of several, the worst."""
    from avrare.estimation.verdict import verdict

    found = {
        verdict(result, threshold.limit, threshold.strict, threshold.confidence)
        for threshold in definition.thresholds
        if threshold.specification == result.specification
    }
    worst = next((name for name in ("fail", "inconclusive", "pass") if name in found), None)
    return replace(result, verdict=worst)


def _executor(args: argparse.Namespace) -> Any:
    """The executor by its name, which options may follow: ``ray,address=auto``."""
    from avrare.estimation.loop import checked_options
    from avrare.plugin.registry import default_registry
    from avrare.scenario.overrides import override
    from avrare.scenario.source import Mark, Node

    default = "processes" if args.workers > 1 else "serial"
    name, *settings = (args.executor or default).split(",")
    component = default_registry().require("executor", name)
    mark = Mark("--executor")
    options = override(Node({}, mark, mark), settings).plain()
    config = checked_options(component.load_config(), name, {"workers": args.workers, **options}, "executor")
    return component.load_factory()(config, None)


def _draw(scenario: Any, results: Sequence[Any], folder: Path) -> list[Path]:
    """Pictures of the nominal and the worst rollouts, where there is a road and matplotlib."""
    from avrare.report import picture

    if scenario.scene is None:
        return []
    if not picture.available():
        print("no pictures: matplotlib is not installed; pip install 'avrare[plot]'", file=sys.stderr)
        return []
    return picture.draw_run(scenario, results, folder)


def _show(
    definition: Scenario, results: Sequence[Any], folder: Path, pictures: Sequence[Path], mode: Any
) -> None:
    from avrare.report.console import notes, screen, show, table, verdicts

    if mode == "quiet":
        print("\n".join(verdicts(definition.name, results)))
        return
    console = screen(mode)
    how = f"{results[0].estimator}, seed {definition.seed}, {definition.confidence:.0%} intervals"
    title = f"{definition.name}  {how}"
    show(console, table(title, results))
    for line in notes(results):
        console.print(line, style="yellow", markup=False)
    console.print(f"results in {folder}" + "".join(f"\n  {path.name}" for path in pictures), markup=False)
