"""``avrare synthesise``: changes numbers of a scenario until its failures are rarer, and proves it."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path

from avrare.base.atomic_files import ensure_writable
from avrare.base.errors import ExitCode, PluginError, UsageError
from avrare.cli.options import (
    DISPLAY,
    NATURAL,
    SAFE,
    SCENARIO,
    SEED,
    SET,
    WORKERS,
    Options,
    add_rows,
    read_rollouts,
)
from avrare.cli.output import print_notes, say
from avrare.estimation.loop.checkpoint import SCENARIO as SCENARIO_FILE
from avrare.estimation.result.result import finite

_LINEAR = {"rate": None, "least": 0.02, "chains": 50, "runs": 4, "moves": 10}
_ANY = {
    "estimator": None,
    "budget": None,
    "run": None,
    "step": 0.1,
    "directions": 0,
    "proof": None,
    "json": False,
    "quiet": False,
}
_EPILOG = """\
A parameter with a dot is a number, list or matrix of the scenario, or an array of a policy network
(controller.arrays.b2); any stack will do. Its derivatives come from the failing tapes of an estimate
(or of --run DIR), run again a little to either side. Start and result are then compared on fresh
tapes; where the start is too rare for them, by two fresh estimates. A parameter without a dot is one
of a linear system: mean, covariance, process_noise, measurement_noise, reference, feedforward, gain,
observer; its gradient is exact. See docs/synthesis.md.

examples:
  avrare synthesise scenarios/cartpole.yaml --specification on_track --parameter controller.gain \\
      --out better
  avrare synthesise scenarios/double_integrator.yaml --parameter gain --steps 3 --out better

exit code: 0 done (any stack: and the change is proved), 3 not shown
"""


_OPTIONS: Options = {
    **SCENARIO,
    **SET,
    "--parameter PATH": ("parameter to change; may be repeated", {"action": "append", "required": True}),
    "--specification NAME": "specification; required if there are several",
    "--steps N": ("estimates at most, with the start (default 5; linear: 10)", {"type": int}),
    "--target P": ("stop at this probability", {"type": float}),
    "--maximise": "raise the probability: for a formula whose violation is wanted",
    **SEED,
    **WORKERS,
    "any stack": {
        "--estimator NAME": "estimator of each step, with its defaults (default: the scenario's)",
        "--budget KIND=N": "budget of each step's estimate: steps=N, rollouts=N or seconds=N",
        "--run DIR": "run of this scenario, whose stored failures are used in the first step",
        "--step X": ("relative step of the differences (default 0.1)", {"type": float, "default": 0.1}),
        "--directions K": (
            "random directions of a gradient, for many numbers (default 0: one number at a time)",
            {**NATURAL, "default": 0},
        ),
        "--proof KIND=N": (
            "fresh tapes of the paired proof, as rollouts=N (default 10000)",
            {"type": read_rollouts},
        ),
    },
    "linear systems": {
        "--rate R": ("rate of the descent on log p (default: 1 / slope^2 at the start)", {"type": float}),
        "--least X": (
            "stop when a step gains less in log p (default 0.02)",
            {"type": float, "default": 0.02},
        ),
        "--chains N": ("chains of each run (default 50)", {"type": int, "default": 50}),
        "--runs N": ("independent runs at each step (default 4)", {"type": int, "default": 4}),
        "--moves N": ("moves of each chain at failures (default 10)", {"type": int, "default": 10}),
    },
    "--out DIR": "write the changed scenario as scenario.yaml into this folder",
    **DISPLAY,
    **SAFE,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.epilog, parser.formatter_class = _EPILOG, argparse.RawDescriptionHelpFormatter
    add_rows(parser, _OPTIONS)


def execute(args: argparse.Namespace) -> int:
    """Descend, prove, and write the changed scenario."""
    args.file = None if args.out is None else Path(args.out) / SCENARIO_FILE
    if args.out is not None:
        ensure_writable(Path(args.out), "--out")
    if all("." not in parameter for parameter in args.parameter):
        _refuse(args, _ANY, "a linear system's parameter")
        return _execute_linear(args)
    _refuse(args, _LINEAR, "a parameter with a dot")
    return _execute_any(args)


def _refuse(args: argparse.Namespace, defaults: Mapping[str, object], what: str) -> None:
    for name, default in defaults.items():
        if getattr(args, name) != default:
            raise UsageError(f"--{name} is not an option for {what}", "see `avrare synthesise --help`")


def _execute_linear(args: argparse.Namespace) -> int:
    points = entry_points(group="avrare_design.synthesis", name="linear")
    if not points:
        raise PluginError(
            f"{args.parameter[0]}: parameters of linear systems need avrare-linear, which is not installed",
            "pip install avrare-linear; a number of any scenario has a dotted path, such as controller.gain",
        )
    if len(args.parameter) > 1:
        raise UsageError("one parameter of a linear system at a time", "leave the others out")
    args.parameter, args.steps = args.parameter[0], 10 if args.steps is None else args.steps
    return int(next(iter(points)).load().execute(args))


def _execute_any(args: argparse.Namespace) -> int:
    from avrare.analysis.causes.tape_runs import TapeRunner
    from avrare.cli.failure_output import progress_line
    from avrare_design.synthesis import synthesise

    with progress_line(args) as progress:
        synthesis = synthesise(
            args.scenario,
            args.parameter,
            args.specification,
            overrides=args.set,
            estimator=args.estimator,
            budget=args.budget,
            steps=5 if args.steps is None else args.steps,
            step=args.step,
            directions=args.directions,
            target=args.target,
            maximise=args.maximise,
            seed=args.seed,
            run=args.run,
            proof=args.proof,
            workers=args.workers,
            runner=TapeRunner(args.workers, progress),
            show=partial(print_notes, args),
        )
    if args.json:
        content = {"specification": synthesis.specification, "proved": synthesis.proved}
        print(json.dumps(finite({**content, "iterations": list(synthesis.table())})))
    else:
        say(*synthesis.conclude()[: 1 if args.quiet else None])
    if args.file is not None and synthesis.proof is not None:
        synthesis.write(args.file)
        print_notes(args, f"{args.file}: the scenario with other {', '.join(synthesis.numbers.paths)}")
    return int(ExitCode.PASS if synthesis.proved else ExitCode.INCONCLUSIVE)
