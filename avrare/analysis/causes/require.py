"""Requirement on a parameter of a scenario; finished trials and chunks are kept: a search can be resumed."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from avrare.analysis.causes.failure_sample import count_trials
from avrare.analysis.causes.requirement import Requirement, Trial
from avrare.analysis.causes.resumption import keep_outcomes
from avrare.analysis.causes.reweighed_trial import Nearby, Reweigher, Score
from avrare.analysis.causes.root_search import Evaluate, find_requirement
from avrare.analysis.causes.scenario_parameters import ParametricScenario
from avrare.analysis.causes.sensitivity import knows_score
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.base.stored_files import check_seal, read_json, seal
from avrare.estimation.loop.loop import Progress, run
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.settings import Settings
from avrare.estimation.result.result import Result
from avrare.rollout.executors.work import build_executor
from avrare.rollout.problem import Problem
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.overrides import as_settings
from avrare.scenario.schema import Threshold

TRIALS = "trials.json"
_WIDE = 5.0
_OWN_MODEL = "the answer is that under the scenario's own model alone: its ensemble is left out"
Show = Callable[[str, Problem], AbstractContextManager[Progress | None]]
"""Called with a label and a problem as each estimate begins; gives its progress display."""


def require(
    path: str | os.PathLike[str],
    parameter: str,
    probability: str | float,
    specification: str | None = None,
    *,
    between: tuple[float, float] | None = None,
    overrides: Sequence[str] = (),
    rollouts: int = 20_000,
    seed: int = 0,
    workers: int = 1,
    out: str | os.PathLike[str] | None = None,
    show: Show | None = None,
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
        seed: Seed of the first estimate; each has its own.
        workers: Number of processes.
        out: Folder that keeps finished estimates, and finished chunks of the one in hand; the same call
            goes on from there.
        show: Progress display.

    Raises:
        UsageError: The parameter or the bound does not fit, or the folder holds another search.
    """
    scenario = ParametricScenario(path, as_settings(overrides))
    name, value = scenario.specification(specification), scenario.value(parameter)
    limit = _read_limit(probability)
    between = between or _choose_range(parameter, value)
    definition = scenario.scenario.definition
    task = {
        "fingerprint": fingerprint(definition),
        "parameter": parameter,
        "specification": name,
        "limit": limit,
        "between": list(between),
        "rollouts": rollouts,
        "seed": seed,
        "confidence": definition.confidence,
    }
    kept = _KeptTrials.open(None if out is None else Path(out) / TRIALS, task)
    whole = isinstance(value, int)

    def evaluate(at: float, share: float, number: int, level: float, nearby: Sequence[float]) -> Trial:
        at = round(at) if whole else float(f"{at:.6g}")
        known = kept.find(number, at)
        return known or kept.add(_estimate(at, share, number, level, [float(f"{one:.6g}") for one in nearby]))

    def _estimate(at: float, share: float, number: int, level: float, nearby: Sequence[float]) -> Trial:
        loaded = scenario.at(parameter, at)
        problem, budget = loaded.problem(name), Budget.parse(f"rollouts={max(1, round(rollouts * share))}")
        settings = Settings(seed + number, level, budget, definition.max_error_rate, definition.suppress)
        chunks, executor = journal(f"trial-{number}"), build_executor(workers)
        with show(f"{parameter}={at:.4g}", problem) if show is not None else nullcontext() as progress:
            [result] = run(problem, loaded.estimator(), executor, settings, progress, chunks)
        trial = Trial(at, result.probability, result.interval, result.rollouts, tuple(result.health))
        if whole or not _reweighable(problem, parameter, result):
            return trial
        moved = Reweigher(problem, at, lambda one: scenario.at(parameter, one).stack.loop.perception, between)
        nearby_estimates = moved.reweigh(result, nearby, level)
        return replace(trial, score=moved.score(result.failures), nearby=nearby_estimates)

    search: Evaluate = evaluate
    with keep_outcomes(None if out is None else Path(out), "require", task) as journal:
        found = find_requirement(search, parameter, name, limit, between, confidence=definition.confidence)
    return replace(found, warnings=(*found.warnings, _OWN_MODEL)) if definition.members else found


def _choose_range(parameter: str, value: float) -> tuple[float, float]:
    if value <= 0.0:
        raise UsageError(f"{parameter} is {value:g}: where should be looked?", "give --between LOW,HIGH")
    least = 1.0 if isinstance(value, int) else 0.0
    return max(least, value / _WIDE), value * _WIDE


def _reweighable(problem: Problem, parameter: str, result: Result) -> bool:
    plain = count_trials(result.estimator, result.rollouts, result.failures, result.diagnostics) > 0
    return plain and parameter.startswith("perception.") and knows_score(problem)


def _read_limit(probability: str | float) -> float:
    try:
        return Threshold.model_validate({"specification": "any", "probability": probability}).limit
    except ValidationError:
        text = f"--probability {probability!r}: should be an upper bound such as '< 1e-4'"
        raise UsageError(text, "quote it: the shell reads < as a redirection") from None


@dataclass
class _KeptTrials:
    path: Path | None
    task: dict[str, Any]
    trials: list[Trial]

    @staticmethod
    def open(path: Path | None, task: dict[str, Any]) -> _KeptTrials:
        if path is None or not path.is_file():
            return _KeptTrials(path, task, [])
        content = read_json(path, "choose another --out")
        check_seal(path, content, "choose another --out, or remove it")
        if content.get("task") != task:
            raise UsageError(f"{path}: holds another search", "choose another --out, or remove it")
        trials = content.get("trials")
        return _KeptTrials(path, task, [_read_trial(path, one) for one in _as_list(path, trials)])

    def find(self, number: int, value: float) -> Trial | None:
        if number >= len(self.trials):
            return None
        trial = self.trials[number]
        if trial.value != value:
            raise UsageError(f"{self.path}: was changed", "choose another --out, or remove it")
        return trial

    def add(self, trial: Trial) -> Trial:
        self.trials.append(trial)
        if self.path is not None:
            with explain_file_errors(f"{self.path}: cannot write", "choose another --out"):
                self.path.parent.mkdir(parents=True, exist_ok=True)
                content = seal({"task": self.task, "trials": [asdict(one) for one in self.trials]})
                write_text(self.path, json.dumps(content, indent=1) + "\n")
        return trial


def _as_list(path: Path, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise UsageError(f"{path}: cannot be read", "choose another --out, or remove it")
    return value


def _read_trial(path: Path, entry: Any) -> Trial:
    try:
        probability, interval = float(entry["probability"]), _read_interval(entry)
        nearby = tuple(_read_nearby(one) for one in entry["nearby"])
        score = None if entry["score"] is None else Score(**{k: float(v) for k, v in entry["score"].items()})
        return Trial(
            entry["value"],
            probability,
            interval,
            int(entry["rollouts"]),
            tuple(map(str, entry["warnings"])),
            score,
            nearby,
        )
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
        raise UsageError(f"{path}: cannot be read", "choose another --out, or remove it") from None


def _read_nearby(entry: Any) -> Nearby:
    return Nearby(float(entry["value"]), float(entry["probability"]), _read_interval(entry))


def _read_interval(entry: Any) -> tuple[float, float]:
    (low, high), probability = map(float, entry["interval"]), float(entry["probability"])
    if not (0.0 <= low <= high <= 1.0 and 0.0 <= probability <= 1.0) or high <= 0.0 < probability:
        raise ValueError(f"{low:g} .. {high:g} is no interval of {entry['probability']}")
    return low, high
