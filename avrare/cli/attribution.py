"""``avrare attribution``: which noise carries the failures of a run, and what perfect parts would save."""

from __future__ import annotations

import argparse
from pathlib import Path

from avrare.analysis.causes.attribution import Attribution, attribute
from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.noise_groups import list_groups
from avrare.analysis.causes.resumption import OpenJournal, identify_run, keep_outcomes
from avrare.analysis.causes.tape_runs import TapeRunner
from avrare.base.errors import ExitCode, UsageError
from avrare.cli.failure_output import progress_line
from avrare.cli.output import print_warnings, show_or_write
from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.results.run import Run
from avrare.results.stored_causes import ATTRIBUTION_FILE
from avrare.results.stored_failures import select_failing
from avrare.rollout.loaded_scenario import LoadedScenario, load
from avrare.scenario.fingerprint import identify


def execute(args: argparse.Namespace) -> int:
    """Attribute the failures of each specification, print the tables and write them."""
    run = Run.read(args.folder)
    args.seed = run.seed if args.seed is None else args.seed
    print_warnings((line, None) for line in run.changes)
    settings: dict[str, list[str]] = {}
    for name, setting in _split(args.variant):
        settings.setdefault(name, []).append(setting)
    variants = {name: load(Path(args.folder) / SCENARIO, several) for name, several in settings.items()}
    names = select_failing(run, args.specification)
    few = [name for name in names if len(run[name].failures.robustness) < 2]
    print_warnings((f"{name}: one failure is too few to attribute", None) for name in few)
    chosen = [name for name in names if name not in few]
    out = None if args.out is None else Path(args.out)
    with keep_outcomes(out, "attribution", _identify(run, chosen, variants, args)) as journal:
        found = {name: _attribute(run, name, variants, args, journal) for name in chosen}
        _show(run, found, args)
    most = run.scenario.definition.max_error_rate
    failed = any(one.errors > most * one.rollouts for one in found.values())
    return int(ExitCode.ROLLOUT_ERRORS if failed else ExitCode.PASS)


def _identify(
    run: Run, names: list[str], variants: dict[str, LoadedScenario], args: argparse.Namespace
) -> dict[str, object]:
    return {
        "specifications": names,
        "fresh": args.fresh,
        "channels": args.channels,
        "seed": args.seed,
        "run": identify_run(run),
        "scenario": identify(run.scenario.definition),
        "variants": {name: identify(one.definition) for name, one in variants.items()},
    }


def _show(run: Run, found: dict[str, Attribution], args: argparse.Namespace) -> None:
    content = {
        name: {
            "probability": run[name].probability,
            "noise": list(one.table()),
            "perfect": list(one.savings_table()),
            "rollouts": one.rollouts,
            "errors": one.errors,
        }
        for name, one in found.items()
    }
    lines = [line for one in found.values() for line in one.lines()]
    show_or_write(args, ATTRIBUTION_FILE, {"attribution": content}, lines)


def _split(variants: list[str]) -> list[tuple[str, str]]:
    pairs = [text.partition(":")[::2] for text in variants]
    for name, setting in pairs:
        if not name or "=" not in setting:
            text = f"--variant {name}:{setting}: should be NAME:KEY=VALUE"
            raise UsageError(text, "for example --variant everywhere:controller.search=everywhere")
    return pairs


def _attribute(
    run: Run,
    name: str,
    variants: dict[str, LoadedScenario],
    args: argparse.Namespace,
    journal: OpenJournal,
) -> Attribution:
    sample, problem = FailureSample.of(run[name]), run.scenario.problem(name)
    others = {label: scenario.problem(name) for label, scenario in variants.items()}
    groups = list_groups(problem, channels=args.channels)
    with progress_line() as progress:
        return attribute(
            problem,
            sample,
            seed=args.seed,
            fresh=args.fresh,
            groups=groups,
            variants=others,
            runner=TapeRunner(args.workers, progress, journal=journal(name)),
        )
