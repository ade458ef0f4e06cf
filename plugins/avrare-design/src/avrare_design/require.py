"""Requirement on a parameter of a scenario, found by estimates at values of the parameter."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from avrare.analysis.causes.resumption import keep_outcomes
from avrare.base.errors import UsageError
from avrare.estimation.combine.specifications import Execution, Watch, show_nothing
from avrare.estimation.estimate import check_scenario
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result.result import Result
from avrare.rollout.executors.work import build_executor
from avrare.rollout.problem import Problem
from avrare.scenario.fingerprint import identify
from avrare.scenario.overrides import as_settings
from avrare.scenario.schema import Threshold
from avrare_design.requirement import Requirement, Trial
from avrare_design.reweighed_trial import Reweigher
from avrare_design.root_search import find_requirement
from avrare_design.scenario_parameters import ParametricScenario
from avrare_design.sensitivity import knows_score


def require(
    path: str | os.PathLike[str],
    parameter: str,
    probability: str | float,
    specification: str | None = None,
    *,
    between: tuple[float, float] | None = None,
    overrides: Sequence[str] = (),
    rollouts: int = 20_000,
    seed: int | None = None,
    workers: int = 1,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    show: Watch | None = None,
) -> Requirement:
    """Find how large (or small) a parameter of a scenario may be for a probability to stay below a bound.

    Args:
        path: YAML file; its estimator makes the estimates.
        parameter: Dotted path of a number.
        probability: Bound, such as "< 1e-4".
        specification: Name; None: the only one.
        between: Smallest and largest value; None: a fifth (of a whole number at least 1) and five times
            the scenario's.
        overrides: Settings as for ``--set``.
        rollouts: Budget of all estimates together.
        seed: Seed of the first estimate; each has its own. None: the scenario's.
        workers: Number of processes.
        out: Folder that keeps finished chunks until the answer is there.
        resume: Continue from the chunks that an interrupted search has left in ``out``.
        show: Progress display.

    Raises:
        UsageError: The parameter or the bound does not fit, or the folder holds another search.
    """
    scenario = ParametricScenario(path, as_settings(overrides))
    name, value = scenario.specification(specification), scenario.value(parameter)
    limit = _read_limit(probability)
    between = between or _choose_range(parameter, value)
    definition = scenario.scenario.definition
    seed = definition.seed if seed is None else seed
    task = {
        "parameter": parameter,
        "specification": name,
        "limit": limit,
        "between": list(between),
        "rollouts": rollouts,
        "seed": seed,
        "scenario": identify(definition),
    }
    with keep_outcomes(None if out is None else Path(out), "require", task, resume) as journal:
        execution = Execution(partial(build_executor, workers), show or show_nothing, journal)
        evaluate = _Evaluation(scenario, parameter, value, name, between, rollouts, seed, execution)
        requirement = find_requirement(
            evaluate, parameter, name, limit, between, confidence=definition.confidence
        )
    note = "the answer is that under the scenario's own model alone: its ensemble is left out"
    return replace(requirement, warnings=(*requirement.warnings, note)) if definition.members else requirement


@dataclass(frozen=True)
class _Evaluation:
    """Estimates of a probability at values of a parameter (``root_search.Evaluate``)."""

    scenario: ParametricScenario
    parameter: str
    value: float
    specification: str
    between: tuple[float, float]
    rollouts: int
    seed: int
    execution: Execution

    def __call__(self, at: float, share: float, number: int, level: float, nearby: Sequence[float]) -> Trial:
        if number == 0:  # the first two trials are at the ends
            for end in self.between:
                loaded = self.scenario.at(self.parameter, self._round(end))
                check_scenario(loaded, self._budget(share), [self.specification])
        at = self._round(at)
        loaded = self.scenario.at(self.parameter, at)
        definition, problem = loaded.definition, loaded.problem(self.specification)
        settings = Settings(
            self.seed + number, level, self._budget(share), definition.max_error_rate, definition.suppress
        )
        label, name = f"{self.parameter}={at:.4g}", f"trial-{number}-at-{at:g}"
        [result] = self.execution.run(label, name, problem, loaded.estimator(), settings)
        trial = Trial(at, result)
        if isinstance(self.value, int) or not _reweighable(problem, self.parameter, result):
            return trial
        moved = Reweigher(problem, at, self._build_perception, self.between)
        estimates = moved.reweigh(result, [float(f"{near:.6g}") for near in nearby], level)
        return replace(trial, score=moved.score(result.failures), nearby=estimates)

    def _build_perception(self, value: float) -> Any:
        return self.scenario.at(self.parameter, value).stack.loop.perception

    def _round(self, value: float) -> float:
        return round(value) if isinstance(self.value, int) else float(f"{value:.6g}")

    def _budget(self, share: float) -> Budget:
        return Budget("rollouts", float(max(1, round(self.rollouts * share))))


def _choose_range(parameter: str, value: float) -> tuple[float, float]:
    if value <= 0.0:
        raise UsageError(f"{parameter} is {value:g}: where should be looked?", "say between which values")
    least = 1.0 if isinstance(value, int) else 0.0
    wide = 5.0
    return max(least, value / wide), value * wide


def _reweighable(problem: Problem, parameter: str, result: Result) -> bool:
    return result.trials > 0 and parameter.startswith("perception.") and knows_score(problem)


def _read_limit(probability: str | float) -> float:
    try:
        return Threshold.model_validate({"specification": "any", "probability": probability}).limit
    except ValidationError:
        text = f"probability {probability!r}: should be an upper bound such as '< 1e-4'"
        raise UsageError(text, "quote it: the shell reads < as a redirection") from None
