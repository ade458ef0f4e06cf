"""Parameters of a scenario: their values by dotted path, and the scenario with another value."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.tape_runs import TapeRunner
from avrare.analysis.failures.failure import compute_fingerprints
from avrare.base.errors import AvrareError, ExitCode, UsageError, did_you_mean
from avrare.estimation.loop.preflight import check_estimate
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result import intervals
from avrare.estimation.result.result import Result
from avrare.results.run import Run
from avrare.rollout.loaded_scenario import LoadedScenario, load, select_specification
from avrare.rollout.problem import Problem
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.overrides import as_settings
from avrare.scenario.schema import Scenario
from avrare.scenario.yaml import dump_list
from avrare_design.sensitivity import (
    Sensitivities,
    Sensitivity,
    derive_by_pairs,
    derive_by_score,
    knows_score,
    sample_failures,
    sort_by_effect,
)

_DEFAULT = "perception."


@dataclass
class ParametricScenario:
    """Scenario of which single values can be changed.

    Attributes:
        path: The file.
        overrides: Settings as for ``--set``.
    """

    path: str | os.PathLike[str]
    overrides: tuple[str, ...] = ()
    _loaded: LoadedScenario | None = field(default=None, init=False)

    @property
    def scenario(self) -> LoadedScenario:
        """The scenario itself."""
        if self._loaded is None:
            self._loaded = load(self.path, self.overrides)
        return self._loaded

    def at(self, parameter: str, value: float) -> LoadedScenario:
        """Return the scenario with another value of a parameter."""
        return self.under(self.settings({parameter: repr(value)}))

    def under(self, settings: Sequence[str]) -> LoadedScenario:
        """Return the scenario under further settings, as for ``--set``."""
        return load(self.path, (*self.overrides, *settings))

    def settings(self, values: Mapping[str, str]) -> tuple[str, ...]:
        """Return the settings, as for ``--set``, that give parameters these values (YAML)."""
        indices = re.compile(r"(\.\d+)+$")
        # A list that is a default is not in the file: it is written out before its entries are set.
        paths = dict.fromkeys(indices.sub("", path) for path in values if indices.search(path))
        lists = {path: look_up(self.scenario.definition.resolved, path) for path in paths}
        written = {path: dump_list(value) for path, value in lists.items() if isinstance(value, list)}
        return tuple(f"{path}={value}" for path, value in [*written.items(), *values.items()])

    def value(self, parameter: str) -> float:
        """Return the value of a parameter, an int where it is a whole number; UsageError if it is none."""
        numbers = dict(_numbers(self.scenario.definition.resolved))
        if parameter not in numbers:
            hint = did_you_mean(parameter, numbers) or "a dotted path such as perception.miss_scale"
            raise UsageError(f"{self.path}: {parameter!r} is not a number of this scenario", hint)
        value = numbers[parameter]
        return float(value) if isinstance(value, int) and self._permits(parameter, value + 0.5) else value

    def _permits(self, parameter: str, value: float) -> bool:
        """Return whether the schema of the scenario permits a value; 1.0 is written as 1."""
        try:
            self.at(parameter, value)
        except AvrareError:
            return False
        return True

    def default_parameters(self) -> list[str]:
        """Return the numbers of the perception error model that the score function can derive."""
        numbers = _numbers(self.scenario.definition.resolved)
        return [
            name
            for name, value in numbers
            if name.startswith(_DEFAULT)
            and isinstance(value, float)
            and value != 0.0
            and name.rsplit(".", 1)[1] not in ("height",)  # a fact about the world
        ]

    def specification(self, name: str | None) -> str:
        """Return the specification to look at; UsageError if it must be named, or is unknown."""
        return select_specification(self.scenario.specifications, name, str(self.path))


def look_up(value: object, path: str) -> object:
    """Look up a dotted path in plain data; None where it is missing."""
    for key in path.split("."):
        if isinstance(value, dict):
            value = value.get(key)
        else:
            value = value[int(key) : int(key) + 1] if isinstance(value, list) and key.isdigit() else []
            value = value[0] if value else None
    return value


def _numbers(value: object, path: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _numbers(entry, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for index, entry in enumerate(value):
            yield from _numbers(entry, f"{path}.{index}")
    elif isinstance(value, (int, float)) and not isinstance(value, bool) and path:
        yield path, value


def sensitivity(
    path: str | os.PathLike[str],
    parameters: Sequence[str] = (),
    specification: str | None = None,
    *,
    overrides: Sequence[str] = (),
    run: str | os.PathLike[str] | None = None,
    rollouts: int = 2000,
    step: float = 0.1,
    seed: int | None = None,
    runner: TapeRunner | None = None,
) -> Sensitivities:
    """Estimate d log p / d parameter for parameters of a scenario.

    Args:
        path: YAML file.
        parameters: Dotted paths; none: all numbers of the perception error model, if it has a score function.
        specification: Name; None: the only one.
        overrides: Settings as for ``--set``.
        run: Run folder of this scenario whose stored failures serve the score function; None: fresh tapes.
        rollouts: Fresh tapes, of the score function without ``run``, and of each paired comparison.
        step: Relative distance to the two values that a paired comparison takes.
        seed: Seed of the fresh tapes; None: the scenario's.
        runner: Runs and counts the tapes.

    Raises:
        UsageError: A parameter is not a number, no rollout fails, or nothing can be derived.
    """
    scenario, tapes = ParametricScenario(path, as_settings(overrides)), runner or TapeRunner()
    name, definition = scenario.specification(specification), scenario.scenario.definition
    seed = definition.seed if seed is None else seed
    problem, confidence = scenario.scenario.problem(name), definition.confidence
    by_score = knows_score(problem)
    chosen = list(as_settings(parameters)) or (scenario.default_parameters() if by_score else [])
    if not chosen:
        text = f"{path}: its perception has no score function, so there are no parameters to begin with"
        raise UsageError(text, "name some, such as controller.horizon")
    values = {parameter: scenario.value(parameter) for parameter in chosen}
    settings = Settings(seed, confidence, None, definition.max_error_rate, definition.suppress)
    check_estimate(problem, MonteCarlo(McConfig()), settings)
    if run is None:
        sample = sample_failures(problem, rollouts, seed, confidence, tapes)
        interval = intervals.clopper_pearson(sample.size, rollouts, confidence, sample.errors)
    else:
        result = read_failing_result(Path(run), name, scenario.scenario)
        sample, interval = FailureSample.of(result), result.interval
    derivation = _Derivation(scenario, problem, sample, rollouts, step, seed, tapes)
    rows = [derivation.derive(parameter, value) for parameter, value in values.items()]
    return Sensitivities(
        name, sample.probability, interval, sort_by_effect(rows), tapes.rollouts, tapes.errors
    )


@dataclass(frozen=True)
class _Derivation:
    """Derivatives of the logarithm of one specification's probability."""

    scenario: ParametricScenario
    problem: Problem
    sample: FailureSample
    rollouts: int
    step: float
    seed: int
    tapes: TapeRunner

    def derive(self, parameter: str, value: float) -> Sensitivity:
        """Return the derivative in a parameter: by the score function where it has one, else by pairs."""
        if knows_score(self.problem) and parameter.startswith(_DEFAULT) and isinstance(value, float):
            build = partial(self._build_perception, parameter)
            row = derive_by_score(self.problem, self.sample, parameter, value, build, self.tapes)
            if not math.isnan(row.derivative):
                return row
        low, high = _ends(self.scenario, parameter, value, self.step, self.problem.names[0])
        row = derive_by_pairs(
            (low.problem, high.problem),
            (low.value, high.value),
            parameter,
            value,
            rollouts=self.rollouts,
            seed=self.seed,
            confidence=self.scenario.scenario.definition.confidence,
            runner=self.tapes,
        )
        return replace(row, refused=(*low.refused, *high.refused))

    def _build_perception(self, parameter: str, value: float) -> Any:
        return self.scenario.at(parameter, value).stack.loop.perception


def read_failing_result(run: Path, name: str, scenario: LoadedScenario) -> Result:
    """Return the stored result of a specification, with failures.

    Raises:
        UsageError: The run stored none, or is of another scenario.
    """
    stored = Run.read(run)
    if name not in stored or not len(stored[name].failures.robustness):
        raise UsageError(f"{run}: no failure of {name} is stored", "leave the run out, or run more rollouts")
    if differences := _find_differences(stored, name, scenario.definition):
        text = f"{run}: its failures are of another scenario: {differences}"
        raise UsageError(text, "give the run of this scenario, or none")
    return stored[name]


def _find_differences(run: Run, name: str, definition: Scenario) -> str:
    # Estimator, budget, seed and thresholds may differ: they decide no rollout of a tape.
    if run.fingerprint == fingerprint(definition):
        return ""
    before = run.definition
    if run.changes or before is None:
        return "; ".join(run.changes or run.build_errors)
    if name not in before.specifications:
        return f"it has no specification {name!r}"
    then, now = (compute_fingerprints(version, name) for version in (before, definition))
    differing = [part for part in now if now[part] != then[part]]
    return f"{', '.join(differing)} differ{'s' * (len(differing) == 1)}" if differing else ""


@dataclass(frozen=True)
class _End:
    # Value on one side of a parameter's own, its problem, and the value there that the scenario refuses.
    value: float
    problem: Problem
    refused: tuple[float, ...] = ()


def _ends(
    scenario: ParametricScenario, parameter: str, value: float, step: float, name: str
) -> tuple[_End, _End]:
    """Return the values below and above between which to compare, each as far as the scenario permits."""
    distance = _distance(value, step)
    reasons: list[str] = []
    low, high = (_reach(scenario, parameter, value, sign * distance, name, reasons) for sign in (-1, 1))
    if low.value == high.value:
        text = f"{parameter} = {value:g}: the scenario permits no value beside it to compare with"
        raise UsageError(text, "; ".join(dict.fromkeys(reasons)))
    return low, high


def _reach(
    scenario: ParametricScenario, parameter: str, value: float, far: float, name: str, reasons: list[str]
) -> _End:
    refused: tuple[float, ...] = ()
    most_halvings = 5  # times that the step to a value which the scenario refuses is halved
    for halving in range(most_halvings + 1):
        part = int(far / 2**halving) if isinstance(far, int) else far / 2**halving
        if not part:
            break
        try:
            return _End(value + part, scenario.at(parameter, value + part).problem(name), refused)
        except AvrareError as error:  # by its schema, or by the parts that are built from it
            if error.exit_code is not ExitCode.USAGE:
                raise
            reasons.append(str(error).partition("\n")[0])
            refused = refused or (value + part,)
    return _End(value, scenario.scenario.problem(name), refused)


def _distance(value: float, step: float) -> float:
    if isinstance(value, int):
        return max(1, round(abs(value) * step))
    return abs(value) * step if value else step
