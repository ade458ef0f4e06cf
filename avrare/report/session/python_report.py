"""Report of results that were made in Python, without a run folder."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from avrare.base import version
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.estimation.result import Failures, Origin, Result
from avrare.report.html.page import render_folder
from avrare.results.reader import Provenance, RolloutSample, RunFolder, StoredResult
from avrare.rollout.loaded_scenario import LoadedScenario, ScenarioProblem
from avrare.rollout.problem import Problem
from avrare.scenario.schema import Scenario
from avrare.scenario.yaml import dump


def write_report(results: Sequence[Result], path: str | os.PathLike[str]) -> Path:
    """Write results of ``avrare.estimate`` as one HTML file; see ``Result.report``."""
    origins = [result.origin for result in results]
    known = [origin for origin in origins if origin is not None]
    if len(known) < len(origins):
        hint = "write the report where avrare.estimate ran, or use avrare.run and `avrare report`"
        raise UsageError("a result does not know its problem, which the report replays", hint)
    text = render_folder(_PythonRun.of(results, known))
    with explain_file_errors(f"{path}: cannot write", "choose another file"):
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        write_text(Path(path), text)
    return Path(path)


@dataclass(frozen=True)
class _PythonRun(RunFolder):
    """Content of a run folder that was never written."""

    results: Sequence[Result] = ()
    origins: Sequence[Origin] = ()

    @classmethod
    def of(cls, results: Sequence[Result], origins: Sequence[Origin]) -> _PythonRun:
        content = {
            "scenario": _scenario_of(origins).name,
            "fingerprint": "",
            "seed": origins[0].seed,
            "versions": {"avrare": version.__version__},
            "estimates": [result.to_dict() for result in results],
        }
        return cls(Path(), content, StoredResult.model_validate(content), results, origins)

    @property
    def provenance(self) -> Provenance:
        return Provenance(python=platform.python_version(), date=datetime.now(UTC))

    @property
    def reproduction(self) -> str:
        return "\n".join(dict.fromkeys(origin.call for origin in self.origins))

    @property
    def scenario(self) -> LoadedScenario:
        return _scenario_of(self.origins)

    def estimator(self, specification: str) -> Any:
        return next(one.estimator for one in self.origins if specification in one.problem.names)

    @property
    def definition(self) -> Scenario | None:
        return getattr(self.scenario, "definition", None)

    @property
    def load_errors(self) -> tuple[str, ...]:
        return ()

    @property
    def scenario_text(self) -> str:
        return "" if self.definition is None else dump(self.definition.resolved)

    @property
    def failures(self) -> Mapping[str, Failures]:
        return {one.specification: one.failures for one in self.results if len(one.failures.robustness)}

    @property
    def samples(self) -> Mapping[str, RolloutSample]:
        return {
            one.specification: RolloutSample(one.robustness.astype(np.float32), one.worst)
            for one in self.results
        }


def _scenario_of(origins: Sequence[Origin]) -> LoadedScenario:
    problem = origins[0].problem
    return problem.scenario if isinstance(problem, ScenarioProblem) else _ProblemScenario(origins)


class _ProblemScenario(LoadedScenario):
    """Scenario that stands for problems of one system."""

    definition: Any = None

    def __init__(self, origins: Sequence[Origin]) -> None:
        self.problems = {one.problem.names[0]: one.problem for one in origins}
        self.first = next(iter(self.problems.values()))

    @property
    def name(self) -> str:
        return type(self.first.system).__name__

    @property
    def steps(self) -> int:
        return self.first.steps

    @property
    def specifications(self) -> tuple[str, ...]:
        return tuple(self.problems)

    @property
    def stack(self) -> Any:
        dt = getattr(self.first.system, "dt", None)
        simulator = SimpleNamespace(noise_size=self.first.noise_size, dt=1.0 if dt is None else dt)
        monitors = {name: one.monitors[0] for name, one in self.problems.items()}
        return SimpleNamespace(loop=SimpleNamespace(simulator=simulator), specifications=monitors)

    @property
    def scene(self) -> None:
        return None

    def problem(self, specification: str | Sequence[str]) -> Problem:
        if isinstance(specification, str):
            return self.problems[specification]
        monitors = {name: self.problems[name].monitors[0] for name in specification}
        return Problem(self.first.system, monitors, self.steps, chunk=self.first.chunk)
