"""``avrare synthesize``: changes numbers of a scenario until its failures are rarer, and proves it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from avrare.base.errors import ExitCode, PluginError, UsageError
from avrare.cli.options import at_least
from avrare.cli.output import say, write_file

if TYPE_CHECKING:
    from avrare.analysis.causes.scenario_numbers import ScenarioNumbers
    from avrare.analysis.causes.synthesis import Iteration, Measured
    from avrare.analysis.causes.synthesis_proof import Proof
    from avrare.rollout.loaded_scenario import LoadedScenario

_SEED_OF_PROOF = 1_000_000
"""Distance of the seeds of the proof from those of the descent."""
_PROOF = 10_000
_SHOWN, _WIDE = 6, 60
"""Most numbers whose values stand in the table, and the longest list of their names."""
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
    stack("--proof", metavar="rollouts=N", help=f"fresh tapes of the paired proof (rollouts={_PROOF})")
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


def _refuse(args: argparse.Namespace, defaults: dict[str, Any], what: str) -> None:
    for name, default in defaults.items():
        if getattr(args, name) != default:
            raise UsageError(f"--{name} is no option for {what}", "see `avrare synthesize --help`")


def _execute_linear(args: argparse.Namespace) -> int:
    from importlib.metadata import entry_points

    from avrare.cli.main import COMMAND_GROUP

    points = entry_points(group=COMMAND_GROUP, name="synthesize")
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
    from avrare.analysis.causes.scenario_numbers import ScenarioNumbers
    from avrare.analysis.causes.scenario_parameters import ParametricScenario
    from avrare.analysis.causes.synthesis import Search, descend
    from avrare.analysis.causes.tape_runs import TapeRunner
    from avrare.cli.failure_output import progress_line
    from avrare.cli.sensitivity import read_rollouts

    settings = [f"estimator.plugin={args.estimator}"] if args.estimator else []
    scenario = ParametricScenario(args.scenario, (*args.set, *settings))
    name, definition = scenario.specification(args.specification), scenario.scenario.definition
    numbers = ScenarioNumbers.of(scenario, args.parameter)
    seed = definition.seed if args.seed is None else args.seed
    iterations = 5 if args.steps is None else args.steps
    search = Search(name, iterations, args.step, args.directions, args.target, args.maximise, seed)
    measuring, proof_rollouts = _Measuring(args, name, seed), read_rollouts(args.proof, _PROOF, "--proof")
    done: list[Iteration] = []
    with progress_line() as progress:
        for iteration in descend(numbers, search, measuring, TapeRunner(args.workers, progress)):
            say(*([_header(numbers)] if not done else []), _line(len(done), iteration, numbers))
            if iteration.refusal:
                say(*(f"      {line}" for line in iteration.refusal.splitlines()))
            done.append(iteration)
    best = [one for one in done if one.best][-1]
    first = done[0].measured
    if best.measured is None or first is None or (best is done[0] and first.failures is None):
        raise UsageError(f"{name}: no failure was found at the start", "give a larger --budget, or --run DIR")
    if best is done[0]:
        reached = search.reached(first.probability)
        why = "the start is at the target" if reached else "no step was better than the start"
        say(f"{why}: nothing is changed")
        return int(ExitCode.INCONCLUSIVE)
    after = numbers.at(best.values)
    proof = _prove(args, measuring, numbers.at(numbers.start), after, first.probability, proof_rollouts)
    say(*proof.lines())
    if args.out is not None:
        from avrare.scenario.yaml import dump

        write_file(args.out, dump(after.definition.resolved), "choose another --out")
        say(f"{args.out}: the scenario with other {', '.join(numbers.paths)}")
    return int(ExitCode.PASS if proof.moved else ExitCode.INCONCLUSIVE)


class _Measuring:
    """Estimates of the descent and of the proof, by the scenario's estimator."""

    def __init__(self, args: argparse.Namespace, name: str, seed: int) -> None:
        self.args, self.name, self.seed = args, name, seed

    def __call__(self, loaded: LoadedScenario, number: int) -> Measured:
        from avrare.analysis.causes.failure_sample import FailureSample
        from avrare.analysis.causes.scenario_parameters import take_sample
        from avrare.analysis.causes.synthesis import Measured

        if number == 0 and self.args.run is not None:
            sample, interval = take_sample(Path(self.args.run), self.name, loaded)
            return Measured(sample.probability, interval, sample, 0)
        result = self.estimate(loaded, self.seed + number, loaded.definition.confidence)
        failures = FailureSample.of(result) if len(result.failures.robustness) else None
        return Measured(result.probability, result.interval, failures, result.rollouts)

    def estimate(self, loaded: LoadedScenario, seed: int, confidence: float, factor: float = 1.0) -> Any:
        """Return the result of the scenario's estimator; ``factor`` enlarges the budget."""
        from avrare.estimation.loop.loop import run
        from avrare.estimation.plan.budget import Budget
        from avrare.estimation.plan.settings import Settings
        from avrare.rollout.executors.work import build_executor

        budget, definition = Budget.parse(self.args.budget), loaded.definition
        if budget is not None:
            budget = Budget(budget.kind, budget.amount * factor)
        settings = Settings(seed, confidence, budget, definition.max_error_rate, definition.suppress)
        [result] = run(
            loaded.problem(self.name), loaded.estimator(), build_executor(self.args.workers), settings
        )
        return result


def _prove(
    args: argparse.Namespace,
    measuring: _Measuring,
    before: LoadedScenario,
    after: LoadedScenario,
    p: float,
    rollouts: int,
) -> Proof:
    from avrare.analysis.causes.synthesis_proof import ENOUGH, Side, prove_by_estimates, prove_by_pairs
    from avrare.rollout.executors.work import build_executor

    seed = measuring.seed + _SEED_OF_PROOF
    if args.proof is not None or p * rollouts >= ENOUGH:
        return prove_by_pairs(
            before, after, measuring.name, rollouts, seed, build_executor(args.workers), args.maximise
        )

    def estimate(loaded: LoadedScenario, number: int, level: float) -> Side:
        found = measuring.estimate(loaded, seed + number, level, 2.0)
        return Side(found.probability, found.interval)

    return prove_by_estimates(before, after, before.definition.confidence, estimate, args.maximise)


def _header(numbers: ScenarioNumbers) -> str:
    what = ", ".join(numbers.names)
    if len(numbers.names) > _SHOWN:
        what = f"change of {len(numbers.names)} numbers"
    elif len(what) > _WIDE:
        what = ", ".join(numbers.paths)
    return f"{'step':<6}{'p':<11}{'interval':<24}{'failures':<10}{'slope':<8}{what}"


def _line(number: int, one: Iteration, numbers: ScenarioNumbers) -> str:
    import numpy as np

    from avrare.base.number_format import format_interval, format_probability

    if len(one.values) <= _SHOWN:
        values = ", ".join(f"{value:.4g}" for value in one.values)
    else:
        moved = (one.values - numbers.start) / numbers.scale
        values = f"{100.0 * float(np.sqrt(np.mean(moved**2))):.3g} %"
    if one.measured is None:
        return f"{number:<6}{'refused':<11}{'':<42}{values}"
    p, interval = format_probability(one.measured.probability), format_interval(one.measured.interval)
    failures = one.measured.failures.size if one.measured.failures is not None else 0
    slope = f"{one.slope:.2g}" if one.gradient is not None else "" if one.best else "worse"
    return f"{number:<6}{p:<11}{interval:<24}{failures:<10}{slope:<8}{values}"
