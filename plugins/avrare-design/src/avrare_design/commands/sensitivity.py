"""``avrare sensitivity``: by how much the probability changes with parameters of the stack."""

from __future__ import annotations

import argparse
from pathlib import Path

from avrare.analysis.causes.resumption import identify_run, keep_outcomes
from avrare.analysis.causes.tape_runs import TapeRunner
from avrare.base.errors import ExitCode
from avrare.cli.failure_output import progress_line
from avrare.cli.options import (
    REPEATABLE,
    RESUMABLE,
    SCENARIO,
    SEED,
    SET,
    WORKERS,
    Options,
    add_rows,
    read_rollouts,
)
from avrare.cli.output import show_or_write
from avrare.results.run import Run
from avrare.scenario.fingerprint import identify
from avrare.scenario.load import load
from avrare_design.scenario_parameters import sensitivity

_OPTIONS: Options = {
    **SCENARIO,
    **SET,
    "--specification NAME": "specification; required if there are several",
    "--parameter KEY": (
        "parameter, for example perception.miss_scale or tracker.gate; may be repeated (default: the "
        "numbers of the perception error model)",
        REPEATABLE,
    ),
    "--run DIR": "run of this scenario, whose stored failures are used in place of fresh tapes",
    "--budget KIND=N": (
        "fresh tapes, of each paired comparison too, as rollouts=N (default 2000)",
        {"type": read_rollouts, "default": 2000},
    ),
    "--step SHARE": (
        "relative distance of the two values of a paired comparison (default 0.1)",
        {"type": float, "default": 0.1},
    ),
    **SEED,
    **WORKERS,
    **RESUMABLE,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_rows(parser, _OPTIONS)


def execute(args: argparse.Namespace) -> int:
    """Estimate the derivatives, print them and write them."""
    definition = load(args.scenario, args.set)
    seed = definition.seed if args.seed is None else args.seed
    task = {
        "specification": args.specification,
        "parameters": args.parameter,
        "rollouts": args.budget,
        "step": args.step,
        "seed": seed,
        "scenario": identify(definition),
        "run": None if args.run is None else identify_run(Run.read(args.run)),
    }
    out = None if args.out is None else Path(args.out)
    with keep_outcomes(out, "sensitivity", task, args.resume) as journal:
        with progress_line(args) as progress:
            sensitivities = sensitivity(
                args.scenario,
                args.parameter,
                args.specification,
                overrides=args.set,
                run=args.run,
                rollouts=args.budget,
                step=args.step,
                seed=seed,
                runner=TapeRunner(args.workers, progress, journal=journal("tapes")),
            )
        content = {
            "specification": sensitivities.specification,
            "probability": sensitivities.probability,
            "interval": list(sensitivities.interval),
            "rollouts": sensitivities.rollouts,
            "errors": sensitivities.errors,
            "sensitivity": list(sensitivities.table()),
        }
        show_or_write(args, "sensitivity.json", content, [sensitivities])
    most = definition.max_error_rate
    return int(
        ExitCode.ROLLOUT_ERRORS if sensitivities.errors > most * sensitivities.rollouts else ExitCode.PASS
    )
