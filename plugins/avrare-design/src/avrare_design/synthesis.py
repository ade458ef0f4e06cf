"""Synthesis: numbers of a scenario changed until its failures are rarer, and the proof that they are."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from avrare.analysis.causes.tape_runs import TapeRunner
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.base.number_format import format_interval, format_probability
from avrare.base.records import Answer, Records
from avrare.estimation.loop.loop import run
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result.result import Result
from avrare.rollout.executors.work import build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.overrides import as_settings
from avrare.scenario.safe_mode import safe_mode
from avrare.scenario.yaml import dump
from avrare_design.descent import Iteration, Search, descend
from avrare_design.scenario_numbers import ScenarioNumbers
from avrare_design.scenario_parameters import ParametricScenario, read_failing_result
from avrare_design.synthesis_proof import ENOUGH, Proof, Side, prove_by_estimates, prove_by_pairs

_MAX_VALUES, _MAX_NAMES_LENGTH = 6, 60
"""Most numbers whose values stand in the table, and the longest list of their names."""


@dataclass(frozen=True, repr=False)
class Synthesis(Answer):
    """Descent of a failure probability, and the proof of its result.

    Attributes:
        specification: Name of the specification.
        numbers: Numbers that may change.
        iterations: Iterations of the descent.
        reached: The probability is at the target.
        proof: Comparison of start and result on fresh noise; None where the start was the best.
    """

    specification: str
    numbers: ScenarioNumbers
    iterations: tuple[Iteration, ...]
    reached: bool
    proof: Proof | None = None

    @property
    def best(self) -> Iteration:
        """Iteration with the best estimate."""
        return [iteration for iteration in self.iterations if iteration.best][-1]

    @property
    def proved(self) -> bool:
        """True if the change of the probability in the right direction is proved."""
        return self.proof is not None and self.proof.moved

    @property
    def scenario_text(self) -> str:
        """The changed scenario as YAML."""
        return dump(self.numbers.at(self.best.values).definition.resolved)

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the changed scenario.

        Raises:
            UsageError: No step was better than the start, or the file cannot be written.
        """
        if self.proof is None:
            text = (
                f"{self.specification}: no step was better than the start, so there is no scenario to write"
            )
            raise UsageError(text, "give a larger budget, or more steps")
        with explain_file_errors(f"{path}: cannot write", "choose another file"):
            write_text(Path(path), self.scenario_text)
        return Path(path)

    def table(self) -> Records:
        """Return one row for each iteration; NaN where the scenario does not accept its values."""
        return Records(
            {
                "probability": iteration.measured.probability if iteration.measured else np.nan,
                "low": iteration.measured.interval[0] if iteration.measured else np.nan,
                "high": iteration.measured.interval[1] if iteration.measured else np.nan,
                "best": iteration.best,
                "slope": iteration.slope,
                **dict(zip(self.numbers.names, map(float, iteration.values), strict=True)),
                "refusal": iteration.refusal,
            }
            for iteration in self.iterations
        )

    def lines(self) -> list[str]:
        """Describe the descent and the proof."""
        descent = [
            line
            for number, iteration in enumerate(self.iterations)
            for line in _describe_iteration(number, iteration, self.numbers)
        ]
        return [*descent, *self.conclude()]

    def conclude(self) -> list[str]:
        """Describe the proof, or why the scenario stays unchanged."""
        if self.proof is not None:
            return self.proof.lines()
        reason = "the start is at the target" if self.reached else "no step was better than the start"
        return [f"{reason}: nothing is changed"]


def synthesise(
    path: str | os.PathLike[str],
    parameters: Sequence[str] | str,
    specification: str | None = None,
    *,
    overrides: Sequence[str] = (),
    estimator: str | None = None,
    budget: Budget | Mapping[str, float] | str | None = None,
    steps: int = 5,
    step: float = 0.1,
    directions: int = 0,
    target: float | None = None,
    maximise: bool = False,
    seed: int | None = None,
    run: str | os.PathLike[str] | None = None,
    proof: int | None = None,
    workers: int = 1,
    runner: TapeRunner | None = None,
    show: Callable[[str], None] | None = None,
    safe: bool = False,
) -> Synthesis:
    """Change numbers of a scenario until its failures are rarer, and prove it on fresh noise.

    Args:
        path: YAML file.
        parameters: Dotted paths of numbers, lists, matrices, or arrays of a policy network.
        specification: Name; None: the only one.
        overrides: Settings as for ``--set``.
        estimator: Name of another estimator, with its default options.
        budget: Budget of each step's estimate, as for ``avrare.estimate``.
        steps: Estimates at most, that of the start included.
        step: Relative step of the differences.
        directions: Random directions of a gradient, for many numbers; 0: each number separately.
        target: Probability that is low enough.
        maximise: Raise the probability instead.
        seed: Seed of the first step; None: the scenario's.
        run: Run folder with stored failures of this scenario, for the first step.
        proof: Fresh tapes of the paired proof; None: 10,000, or two estimates where the start is too rare.
        workers: Number of processes.
        runner: Runs and counts the tapes.
        show: Called with each line on the descent as it becomes known.
        safe: As for ``avrare.load``.

    Raises:
        UsageError: A parameter has no numbers, or no failure was found at the start.
    """
    chosen = _require_dotted(parameters)
    settings = [f"estimator.plugin={estimator}"] if estimator else []
    scenario = ParametricScenario(path, (*as_settings(overrides), *settings))
    with safe_mode(safe):
        name, definition = scenario.specification(specification), scenario.scenario.definition
    numbers = ScenarioNumbers.of(scenario, chosen)
    first_seed = definition.seed if seed is None else seed
    search = Search(name, steps, step, directions, target, maximise, first_seed)
    estimates = _Estimates(name, first_seed, Budget.parse(budget), workers, run)
    descent = descend(numbers, search, estimates.measure, runner or TapeRunner(workers))
    iterations = tuple(_show_each(descent, numbers, show))
    best = [iteration for iteration in iterations if iteration.best][-1]
    proven = None if best is iterations[0] else estimates.prove(numbers, iterations[0], best, proof, maximise)
    return Synthesis(name, numbers, iterations, search.is_reached(best.estimate.probability), proven)


def _require_dotted(parameters: Sequence[str] | str) -> tuple[str, ...]:
    paths = as_settings(parameters)
    if any("." not in path for path in paths):
        hint = "`avrare synthesise` takes it; numbers of any scenario have a path such as controller.gain"
        raise UsageError(f"{', '.join(paths)}: a parameter without a dot is that of a linear system", hint)
    return paths


def _show_each(
    descent: Iterator[Iteration], numbers: ScenarioNumbers, show: Callable[[str], None] | None
) -> Iterator[Iteration]:
    for number, iteration in enumerate(descent):
        if show is not None:
            for line in _describe_iteration(number, iteration, numbers):
                show(line)
        yield iteration


@dataclass(frozen=True)
class _Estimates:
    """Estimates of the descent and of the proof, by the scenario's estimator."""

    specification: str
    seed: int
    budget: Budget | None
    workers: int
    run: str | os.PathLike[str] | None

    def measure(self, scenario: LoadedScenario, number: int) -> Result:
        """Return the estimate of an iteration; the first one may be that of a run."""
        if number == 0 and self.run is not None:
            return read_failing_result(Path(self.run), self.specification, scenario)
        return self._estimate(scenario, self.seed + number, scenario.definition.confidence)

    def prove(
        self,
        numbers: ScenarioNumbers,
        start: Iteration,
        best: Iteration,
        rollouts: int | None,
        maximise: bool,
    ) -> Proof:
        """Compare start and result on the same fresh tapes; where few would fail, by two estimates."""
        before, after = numbers.at(start.values), numbers.at(best.values)
        seed_distance = 1_000_000  # distance of the seeds of the proof from those of the descent
        proof_rollouts = 10_000
        seed, tapes = self.seed + seed_distance, proof_rollouts if rollouts is None else rollouts
        if rollouts is not None or start.estimate.probability * tapes >= ENOUGH:
            executor = build_executor(self.workers)
            return prove_by_pairs(before, after, self.specification, tapes, seed, executor, maximise)

        def estimate(scenario: LoadedScenario, number: int, level: float) -> Side:
            result = self._estimate(scenario, seed + number, level, 2.0)
            return Side(result.probability, result.interval)

        return prove_by_estimates(before, after, before.definition.confidence, estimate, maximise)

    def _estimate(
        self, scenario: LoadedScenario, seed: int, confidence: float, factor: float = 1.0
    ) -> Result:
        budget, definition = self.budget, scenario.definition
        if budget is not None:
            budget = Budget(budget.kind, budget.amount * factor)
        settings = Settings(seed, confidence, budget, definition.max_error_rate, definition.suppress)
        problem, executor = scenario.problem(self.specification), build_executor(self.workers)
        return run(problem, scenario.estimator(), executor, settings)[0]


def _describe_heads(numbers: ScenarioNumbers) -> str:
    names = ", ".join(numbers.names)
    if len(numbers.names) > _MAX_VALUES:
        names = f"change of {len(numbers.names)} numbers"
    elif len(names) > _MAX_NAMES_LENGTH:
        names = ", ".join(numbers.paths)
    return f"{'step':<6}{'p':<11}{'interval':<24}{'failures':<10}{'slope':<8}{names}"


def _describe_iteration(number: int, iteration: Iteration, numbers: ScenarioNumbers) -> list[str]:
    if len(iteration.values) <= _MAX_VALUES:
        values = ", ".join(f"{value:.4g}" for value in iteration.values)
    else:
        change = (iteration.values - numbers.start) / numbers.scale
        values = f"{100.0 * float(np.sqrt(np.mean(change**2))):.3g} %"
    heads = [_describe_heads(numbers)] if number == 0 else []
    refusal = [f"      {line}" for line in iteration.refusal.splitlines()]
    measured = iteration.measured
    if measured is None:
        return [*heads, f"{number:<6}{'refused':<11}{'':<42}{values}", *refusal]
    p, interval = format_probability(measured.probability), format_interval(measured.interval)
    failures = len(measured.failures.robustness)
    slope = f"{iteration.slope:.2g}" if iteration.gradient is not None else "" if iteration.best else "worse"
    return [*heads, f"{number:<6}{p:<11}{interval:<24}{failures:<10}{slope:<8}{values}", *refusal]
