"""``avrare synthesize``: a scenario's linear system, changed so that it fails less."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from avrare.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from avrare.rollout.problem import Problem
    from avrare_linear.synthesis import Step

_PARAMETERS = (
    "mean", "covariance", "process_noise", "measurement_noise", "reference", "feedforward", "gain", "observer"
)  # fmt: skip
_CONFIRM = 1_000_000
"""Seeds of the estimates before and after lie this far from those of the descent."""
_EXAMPLE = """\
examples:
  avrare synthesize scenarios/four_squares.yaml --parameter mean --rate 0.1 --out better.yaml
  avrare synthesize scenarios/double_integrator.yaml --parameter gain --steps 3 --out better.yaml
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.epilog = _EXAMPLE
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file whose simulator is linear")
    parser.add_argument("--parameter", required=True, choices=_PARAMETERS, help="what may change")
    parser.add_argument("--specification", metavar="NAME", help="of a scenario that has several")
    parser.add_argument(
        "--steps", type=int, default=10, metavar="N", help="gradients at most, the first at the start (10)"
    )
    parser.add_argument(
        "--rate", type=float, metavar="R", help="of the descent on log p; without: 1 / slope^2 at the start"
    )
    parser.add_argument("--target", type=float, default=0.0, metavar="P", help="stop at this probability")
    parser.add_argument(
        "--least", type=float, default=0.02, metavar="X", help="stop where a step gains less in log p (0.02)"
    )
    parser.add_argument("--chains", type=int, default=50, metavar="N", help="of a run at each step (50)")
    parser.add_argument("--runs", type=int, default=4, metavar="N", help="independent runs at each step (4)")
    parser.add_argument("--moves", type=int, default=10, metavar="N", help="of the chains at failures (10)")
    parser.add_argument("--seed", type=int, metavar="N", help="of the first step; the scenario's, or 0")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override one value")
    parser.add_argument("--out", metavar="FILE.yaml", help="write the changed scenario")


def execute(args: argparse.Namespace) -> int:
    """Descend, estimate anew before and after, and write the changed scenario."""
    import avrare

    if args.out is not None and not Path(args.out).parent.is_dir():
        raise UsageError(f"{args.out}: there is no folder {Path(args.out).parent}")
    if args.out is not None and Path(args.out).is_dir():
        raise UsageError(f"{args.out}: is a folder")
    scenario = avrare.load(args.scenario, args.set)
    problem = scenario.problem(_specification(args.specification, scenario.specifications))
    seed = scenario.definition.seed if args.seed is None else args.seed
    steps = _descend(args, problem, seed)
    best = min(steps, key=lambda step: step.probability)
    said = f"the scenario with its {args.parameter} changed"
    if best is steps[0]:
        print(f"no step was better than the start: the {args.parameter} stays as it is")
        said = "the scenario as it was"
    else:
        _compare(problem, _changed(problem, args.parameter, best), seed + _CONFIRM, 2 * args.chains)
    if args.out is not None:
        _write(Path(args.out), scenario.definition.resolved, args.parameter, best)
        print(f"{args.out}: {said}")
    return int(ExitCode.PASS)


def _compare(problem: Problem, changed: Problem, seed: int, chains: int) -> None:
    """Estimates that the descent has not chosen among."""
    import avrare

    print("fresh estimates:")
    for name, one in (("before", problem), ("after", changed)):
        found = avrare.estimate(one, "ess_linear", seed=seed, chains=chains)
        low, high = found.interval
        print(f"  {name:<7}{found.probability:.3g}   {found.confidence:.0%}: {low:.3g} .. {high:.3g}")


def _specification(name: str | None, known: tuple[str, ...]) -> str:
    if name is None and len(known) > 1:
        raise UsageError("the scenario has several specifications", f"--specification {known[0]}")
    return known[0] if name is None else name


def _descend(args: argparse.Namespace, problem: Problem, seed: int) -> list[Step]:
    from avrare_linear.rewrite import ATTRIBUTES, has
    from avrare_linear.simulator import system_of
    from avrare_linear.synthesis import Effort, synthesise

    system = system_of(problem)
    if not has(system, args.parameter):
        there = ", ".join(parameter for parameter in ATTRIBUTES if has(system, parameter))
        raise UsageError(f"the system has no {args.parameter}", f"it has {there}")
    formula: Any = getattr(problem.monitors[0], "formula", None)
    if formula is None:
        raise UsageError(f"synthesis needs a formula, and {problem.names[0]} is none")
    effort = Effort(args.chains, args.runs, args.moves)
    count = iter(range(args.steps))

    def told(step: Step) -> None:
        slope = float((step.gradient**2).sum()) ** 0.5
        largest = float(abs(step.parameter).max())
        number = next(count)
        if number == 0:  # not before: a wrong option is told by then
            print(f"{'step':<6}{'p':<11}{'slope of log p':<16}largest entry")
        print(f"{number:<6}{step.probability:<11.3g}{slope:<16.3g}{largest:.4g}", flush=True)

    return synthesise(
        system, formula, problem.steps, ATTRIBUTES[args.parameter], rate=args.rate, iterations=args.steps,
        target=args.target, least=args.least, effort=effort, seed=seed, told=told,
    )  # fmt: skip


def _changed(problem: Problem, parameter: str, step: Step) -> Problem:
    """The problem of the changed system; its signals are the same."""
    from dataclasses import replace

    from avrare.rollout.problem import Problem
    from avrare_linear.rewrite import ATTRIBUTES
    from avrare_linear.simulator import system_of

    changes: dict[str, Any] = {ATTRIBUTES[parameter]: step.parameter}
    monitors = dict(zip(problem.names, problem.monitors, strict=True))
    return Problem(replace(system_of(problem), **changes), monitors, problem.steps, chunk=problem.chunk)


def _write(path: Path, resolved: dict[str, Any], parameter: str, step: Step) -> None:
    from avrare.record.whole import write_text
    from avrare.scenario.yaml import dump
    from avrare_linear.rewrite import rewritten

    try:
        write_text(path, dump(rewritten(resolved, parameter, step.parameter)))
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
