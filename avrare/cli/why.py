"""``avrare why``: the kinds of a run's failures, the noise behind them, and savings by perfect parts."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from avrare.analysis.causes.attribution import Attribution, attribute
from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.kind_descriptions import describe_kinds
from avrare.analysis.causes.kinds import Kinds, find_kinds
from avrare.analysis.causes.noise_groups import list_groups
from avrare.analysis.causes.resumption import OpenJournal, identify_run, keep_outcomes
from avrare.analysis.causes.tape_runs import TapeRunner
from avrare.analysis.failures.shrink import BUDGET
from avrare.base.errors import ExitCode, UsageError
from avrare.base.number_format import format_duration
from avrare.cli.failure_output import progress_line
from avrare.cli.output import print_warnings, say, show_or_write
from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.results.run import Run
from avrare.results.stored_causes import WHY_FILE
from avrare.results.stored_failures import select_failing
from avrare.rollout.loaded_scenario import LoadedScenario, load
from avrare.rollout.replay import replay_tape
from avrare.scenario.fingerprint import identify

_BATCHES = 35
"""Batches of rollouts, one after the other, that mostly shrink a failure."""
_ANNOUNCED_SECONDS = 5.0
"""Work that is announced with the time that it takes."""


def execute(args: argparse.Namespace) -> int:
    """Find the causes of each specification's failures, print them and write them."""
    if args.budget is not None and not args.shrink:
        raise UsageError("--budget requires --shrink", "it bounds the rollouts that shrink a failure")
    run = Run.read(args.folder)
    args.seed = run.seed if args.seed is None else args.seed
    print_warnings((line, None) for line in run.changes)
    variants = _load_variants(args)
    names = select_failing(run, args.specification)
    several = [name for name in names if len(run[name].failures.robustness) > 1]
    print_warnings(
        (f"{name}: one failure is too few to attribute", None) for name in names if name not in several
    )
    out = None if args.out is None else Path(args.out)
    with keep_outcomes(out, "why", _identify(run, several, variants, args), args.resume) as journal:
        kinds = {name: _find_kinds(run, name, args) for name in names}
        attributions = {name: _attribute(run, name, variants, args, journal) for name in several}
        content = {
            "kinds": {name: _describe_kinds(kinds[name]) for name in names},
            "attribution": {name: _describe_attribution(run, name, attributions[name]) for name in several},
        }
        answers = [answer for name in names for answer in (kinds[name], attributions.get(name)) if answer]
        show_or_write(args, WHY_FILE, content, answers)
    limit = run.scenario.definition.max_error_rate
    failed = any(attribution.errors > limit * attribution.rollouts for attribution in attributions.values())
    return int(ExitCode.ROLLOUT_ERRORS if failed else ExitCode.PASS)


def _load_variants(args: argparse.Namespace) -> dict[str, LoadedScenario]:
    settings: dict[str, list[str]] = {}
    for text in args.variant:
        name, _, setting = text.partition(":")
        if not name or "=" not in setting:
            raise UsageError(
                f"--variant {text}: should be NAME:KEY=VALUE",
                "for example --variant everywhere:controller.search=everywhere",
            )
        settings.setdefault(name, []).append(setting)
    return {name: load(Path(args.folder) / SCENARIO, several) for name, several in settings.items()}


def _identify(
    run: Run, names: list[str], variants: Mapping[str, LoadedScenario], args: argparse.Namespace
) -> dict[str, object]:
    return {
        "specifications": names,
        "fresh": args.fresh,
        "channels": args.channels,
        "seed": args.seed,
        "run": identify_run(run),
        "scenario": identify(run.scenario.definition),
        "variants": {name: identify(variant.definition) for name, variant in variants.items()},
    }


def _find_kinds(run: Run, name: str, args: argparse.Namespace) -> Kinds:
    result, problem = run[name], run.scenario.problem(name)
    kinds = find_kinds(result, args.max_kinds, args.method)
    if not args.shrink:
        return kinds
    budget = BUDGET if args.budget is None else args.budget
    count, began = len(kinds), time.perf_counter()
    replay_tape(problem, result.failures.noise[kinds[0].representative])
    seconds = count * _BATCHES * (time.perf_counter() - began)
    work = f"{count} failure{'s' * (count > 1)} to shrink, in some {_BATCHES} batches of rollouts each"
    _announce(args, seconds, f"{name}: {work}")
    with progress_line(args) as progress:
        return describe_kinds(problem, kinds, result.failures.noise, budget, progress)


def _attribute(
    run: Run,
    name: str,
    variants: Mapping[str, LoadedScenario],
    args: argparse.Namespace,
    journal: OpenJournal,
) -> Attribution:
    problem, result = run.scenario.problem(name), run[name]
    groups, kept = list_groups(problem, channels=args.channels), len(result.failures.robustness)
    perfect = sum(group.sort != "time" for group in groups) + len(variants)
    rollouts = 2 * len(groups) * kept + perfect * (kept + args.fresh)
    seconds = rollouts * result.seconds / result.rollouts / args.workers
    work = f"some {rollouts:,} rollouts for the causes, fewer with a smaller --fresh"
    _announce(args, seconds, f"{name}: {work}")
    with progress_line(args) as progress:
        return attribute(
            problem,
            FailureSample.of(result),
            seed=args.seed,
            fresh=args.fresh,
            groups=groups,
            variants={label: scenario.problem(name) for label, scenario in variants.items()},
            runner=TapeRunner(args.workers, progress, journal=journal(name)),
        )


def _announce(args: argparse.Namespace, seconds: float, work: str) -> None:
    if seconds >= _ANNOUNCED_SECONDS and not args.quiet:
        say(f"{work}: about {format_duration(seconds)}", error=True)


def _describe_kinds(kinds: Kinds) -> dict[str, object]:
    return {
        "probability": kinds.result.probability,
        "kinds": list(kinds.table()),
        "points": np.round(kinds.points, 4).tolist(),
        "labels": kinds.labels.tolist(),
    }


def _describe_attribution(run: Run, name: str, attribution: Attribution) -> dict[str, object]:
    return {
        "probability": run[name].probability,
        "noise": list(attribution.table()),
        "perfect": list(attribution.savings_table()),
        "rollouts": attribution.rollouts,
        "errors": attribution.errors,
    }
