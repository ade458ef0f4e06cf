"""Route of ``avrare synthesise`` for linear systems: descent along exact gradients."""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from avrare.base.errors import ExitCode, UsageError, did_you_mean

if TYPE_CHECKING:
    from avrare.rollout.problem import Problem
    from avrare_linear.synthesis import DescentStep

_PARAMETERS = (
    "mean",
    "covariance",
    "process_noise",
    "measurement_noise",
    "reference",
    "feedforward",
    "gain",
    "observer",
)


def execute(args: argparse.Namespace) -> int:
    """Descend, estimate start and result with fresh seeds, and write the changed scenario."""
    import avrare

    if args.parameter not in _PARAMETERS:
        hint = did_you_mean(args.parameter, _PARAMETERS) or f"one of {', '.join(_PARAMETERS)}"
        raise UsageError(f"--parameter {args.parameter}: a linear system has no parameter of this name", hint)
    scenario = avrare.load(args.scenario, args.set)
    problem = scenario.problem(_specification(args.specification, scenario.specifications))
    seed = scenario.definition.seed if args.seed is None else args.seed
    steps = _descend(args, problem, seed)
    sign = -1.0 if args.maximise else 1.0
    best = min(steps, key=lambda step: sign * step.probability)
    written = f"the scenario with another {args.parameter}"
    if best is steps[0]:
        print(f"no step was better than the start: the {args.parameter} is unchanged")
        written = "the scenario, unchanged"
    else:
        seed_offset = 1_000_000  # distance of the seeds of the final estimates from those of the descent
        _compare(problem, _change(problem, args.parameter, best), seed + seed_offset, 2 * args.chains)
    if args.file is not None:
        _write(args.file, scenario.definition.resolved, args.parameter, best)
        print(f"{args.file}: {written}")
    return int(ExitCode.PASS)


def _compare(problem: Problem, changed: Problem, seed: int, chains: int) -> None:
    # Fresh estimates are not biased by the choice of the best step.
    import avrare

    print("fresh estimates:")
    for name, version in (("before", problem), ("after", changed)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", avrare.HealthWarning)  # their names stand in the line
            result = avrare.estimate(version, "ess_linear", seed=seed, chains=chains)
        low, high = result.interval
        names = "".join(f", {warning}" for warning in result.health)
        print(
            f"  {name:<7}{result.probability:.3g}   {result.confidence:.0%}: {low:.3g} .. {high:.3g}{names}"
        )


def _specification(name: str | None, names: tuple[str, ...]) -> str:
    if name is None and len(names) > 1:
        raise UsageError("the scenario has several specifications", f"choose one: --specification {names[0]}")
    return names[0] if name is None else name


def _descend(args: argparse.Namespace, problem: Problem, seed: int) -> list[DescentStep]:
    from avrare_linear.rewrite import ATTRIBUTES, has_parameter
    from avrare_linear.simulator import system_of
    from avrare_linear.synthesis import Effort, synthesise

    system = system_of(problem)
    if not has_parameter(system, args.parameter):
        present = ", ".join(parameter for parameter in ATTRIBUTES if has_parameter(system, parameter))
        raise UsageError(f"the system has no {args.parameter}", f"it has {present}")
    formula = problem.monitors[0].formula
    if formula is None:
        raise UsageError(f"synthesis needs a formula: {problem.names[0]} is not given as stl")
    effort = Effort(args.chains, args.runs, args.moves)
    count = iter(range(args.steps))

    def print_step(step: DescentStep) -> None:
        slope = float((step.gradient**2).sum()) ** 0.5
        largest = float(abs(step.parameter).max())
        number = next(count)
        if number == 0:  # only now, as a wrong option is refused before the first step
            print(f"{'step':<6}{'p':<11}{'slope of log p':<16}largest entry")
        print(f"{number:<6}{step.probability:<11.3g}{slope:<16.3g}{largest:.4g}", flush=True)

    return synthesise(
        system,
        formula,
        problem.steps,
        ATTRIBUTES[args.parameter],
        rate=args.rate,
        iterations=args.steps,
        target=args.target,
        least=args.least,
        effort=effort,
        seed=seed,
        on_step=print_step,
        maximise=args.maximise,
    )


def _change(problem: Problem, parameter: str, step: DescentStep) -> Problem:
    from dataclasses import replace

    from avrare.rollout.problem import Problem
    from avrare_linear.rewrite import ATTRIBUTES
    from avrare_linear.simulator import system_of

    changes: dict[str, Any] = {ATTRIBUTES[parameter]: step.parameter}
    monitors = dict(zip(problem.names, problem.monitors, strict=True))
    return Problem(replace(system_of(problem), **changes), monitors, problem.steps, chunk=problem.named_chunk)


def _write(path: Path, resolved: dict[str, object], parameter: str, step: DescentStep) -> None:
    from avrare.base.atomic_files import write_text
    from avrare.scenario.yaml import dump
    from avrare_linear.rewrite import rewrite_scenario

    try:
        write_text(path, dump(rewrite_scenario(resolved, parameter, step.parameter)))
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
