"""``avrare synthesize``: changes numbers of a scenario until its failures are rarer, and proves it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from importlib.metadata import entry_points
from pathlib import Path

from avrare.base.errors import ExitCode, PluginError, UsageError
from avrare.cli.options import at_least, read_rollouts
from avrare.cli.output import say

_GROUP = "avrare_design.synthesis"
_LINEAR = {"rate": None, "least": 0.02, "chains": 50, "runs": 4, "moves": 10}
_ANY = {
    "estimator": None,
    "budget": None,
    "run": None,
    "step": 0.1,
    "directions": 0,
    "proof": None,
    "workers": 1,
}
_EPILOG = """\
A parameter with a dot is a number, list or matrix of the scenario, or an array of a policy network
(controller.arrays.b2); any stack will do. Its derivatives come from the failing tapes of an estimate
(or of --run DIR), run again a little to either side. Start and result are then compared on fresh
tapes; where the start is too rare for them, by two fresh estimates. A parameter without a dot is one
of a linear system: mean, covariance, process_noise, measurement_noise, reference, feedforward, gain,
observer; its gradient is exact. See docs/synthesis.md.

examples:
  avrare synthesize scenarios/cartpole.yaml --specification on_track --parameter controller.gain \\
      --out better.yaml
  avrare synthesize scenarios/double_integrator.yaml --parameter gain --steps 3 --out better.yaml

exit code: 0 done (any stack: and the change is proved), 3 not shown
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.epilog, parser.formatter_class = _EPILOG, argparse.RawDescriptionHelpFormatter
    add = parser.add_argument
    add("scenario", metavar="SCENARIO", help="scenario file")
    add("--parameter", required=True, action="append", metavar="PATH", help="what to change; may be repeated")
    add("--specification", metavar="NAME", help="specification, if the scenario has several")
    add(
        "--steps",
        type=int,
        metavar="N",
        help="estimates at most, with the start (5; linear: 10)",
    )
    add("--target", type=float, metavar="P", help="stop at this probability")
    add(
        "--maximise",
        action="store_true",
        help="raise the probability: for a formula whose violation is wanted",
    )
    add("--seed", type=int, metavar="N", help="seed of the first step (the scenario's, or 0)")
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="override one value")
    add("--out", metavar="FILE.yaml", help="write the changed scenario")
    add("--safe", action="store_true", help="as of `avrare run`: for scenarios of strangers")
    stack = parser.add_argument_group("any stack").add_argument
    stack("--estimator", metavar="NAME", help="estimator of each step, with its defaults (the scenario's)")
    stack("--budget", metavar="KIND=N", help="of each step's estimate, as of `avrare run`")
    stack("--run", metavar="DIR", help="run folder with stored failures of this scenario, for the first step")
    stack("--step", type=float, default=0.1, metavar="X", help="step of the differences, relative (0.1)")
    stack(
        "--directions",
        type=at_least(0),
        default=0,
        metavar="K",
        help="random directions of a gradient, for many numbers (0: each number by itself)",
    )
    stack(
        "--proof",
        type=read_rollouts,
        metavar="KIND=N",
        help="fresh tapes of the paired proof, as rollouts=N (10000)",
    )
    stack("--workers", type=at_least(1), default=1, metavar="N", help="processes (1)")
    linear = parser.add_argument_group("linear systems").add_argument
    linear("--rate", type=float, metavar="R", help="of the descent on log p (1 / slope^2 at the start)")
    linear(
        "--least", type=float, default=0.02, metavar="X", help="stop when a step gains less in log p (0.02)"
    )
    linear("--chains", type=int, default=50, metavar="N", help="chains of each run (50)")
    linear("--runs", type=int, default=4, metavar="N", help="independent runs at each step (4)")
    linear("--moves", type=int, default=10, metavar="N", help="moves of each chain at failures (10)")


def execute(args: argparse.Namespace) -> int:
    """Descend, prove, and write the changed scenario."""
    if args.out is not None and not Path(args.out).parent.is_dir():
        raise UsageError(f"{args.out}: there is no folder {Path(args.out).parent}")
    if args.out is not None and Path(args.out).is_dir():
        raise UsageError(f"{args.out}: is a folder", "name a file")
    if all("." not in parameter for parameter in args.parameter):
        _refuse(args, _ANY, "a linear system's parameter")
        return _execute_linear(args)
    _refuse(args, _LINEAR, "a parameter with a dot")
    return _execute_any(args)


def _refuse(args: argparse.Namespace, defaults: Mapping[str, object], what: str) -> None:
    for name, default in defaults.items():
        if getattr(args, name) != default:
            raise UsageError(f"--{name} is no option for {what}", "see `avrare synthesize --help`")


def _execute_linear(args: argparse.Namespace) -> int:
    points = entry_points(group=_GROUP, name="linear")
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
    from avrare_design.synthesis import synthesize

    with progress_line() as progress:
        synthesis = synthesize(
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
            show=say,
        )
    say(*synthesis.conclude())
    if args.out is not None and synthesis.proof is not None:
        synthesis.write(args.out)
        say(f"{args.out}: the scenario with other {', '.join(synthesis.numbers.paths)}")
    return int(ExitCode.PASS if synthesis.proved else ExitCode.INCONCLUSIVE)
