"""Run: results with where they come from, in a folder whose files are written whole, result.json last."""

from __future__ import annotations

import json
import os
import platform
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from avrare.base import version
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import AvrareError, UsageError, require_path
from avrare.base.stored_files import check_model, check_seal, digest, read_json, read_regular, seal
from avrare.estimation.loop.checkpoint import SCENARIO, resume_hint
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Estimator
from avrare.estimation.result.result import Origin, Result, ResultMapping, Results
from avrare.estimation.result.verdict import worst_verdict
from avrare.results.provenance import Provenance
from avrare.results.stored_causes import WHY_FILE
from avrare.results.stored_results import (
    RUN_AGAIN,
    Name,
    StoredEstimate,
    read_failures,
    read_rollouts,
    write_failures,
    write_rollouts,
)
from avrare.rollout.loaded_scenario import LoadedScenario, ScenarioProblem
from avrare.rollout.problem import Problem
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.safe_mode import is_outside
from avrare.scenario.schema import Scenario, Threshold
from avrare.scenario.yaml import MAX_BYTES, dump

RESULT, PROVENANCE = "result.json", "provenance.json"
_SCHEMA = 1
"""Format of result.json."""


class _StoredRun(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True)

    scenario: Name
    fingerprint: Name
    seed: int
    versions: dict[Name, Name]
    estimates: Annotated[list[StoredEstimate], Field(min_length=1)]
    files: dict[str, str] = {}


@dataclass(frozen=True, eq=False, repr=False)
class Run(ResultMapping):
    """Results by specification, ``run["safe_distance"]``, and where they come from.

    Attributes:
        name: Name of the scenario; of a problem, that of its system's class.
        results: The results.
        seed: Seed of the estimates.
        fingerprint: Fingerprint of the scenario; empty for a problem.
        versions: Versions of avrare and of the plugins.
        provenance: Command, commit and date.
        definition: The scenario; None for a problem, and where it cannot be loaded any more.
        scenario_text: The resolved scenario as YAML; empty for a problem, and where it cannot be read.
        folder: Folder that it was read from or written to; None where there is none.
        files: Digests of scenario.yaml and of the files that the estimators leave, by name.
        changes: Lines on files that have changed since the run.
        replies: Lines of the installed result callbacks.
    """

    name: str
    results: Results
    seed: int
    fingerprint: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)
    definition: Scenario | None = None
    scenario_text: str = ""
    folder: Path | None = None
    files: Mapping[str, str] = field(default_factory=dict)
    changes: tuple[str, ...] = ()
    replies: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Result:
        return self.results[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.results)

    def __len__(self) -> int:
        return len(self.results)

    @staticmethod
    def of_scenario(scenario: Scenario, results: Sequence[Result], budget: Budget | None = None) -> Run:
        """Return the run of a scenario that this process has made."""
        text = dump(scenario.resolved)
        files = _encode_files(text, results)
        return Run(
            scenario.name,
            Results(results),
            scenario.seed,
            fingerprint(scenario),
            scenario.versions,
            Provenance.collect(scenario, budget),
            scenario,
            text,
            files={name: digest(content) for name, content in files.items()},
        )

    @staticmethod
    def of_results(results: Sequence[Result]) -> Run:
        """Return the run that results of ``avrare.estimate`` make together.

        Raises:
            UsageError: A result does not know its problem.
        """
        origins = [result.require_origin() for result in results]
        problem = origins[0].problem
        scenario = problem.scenario if isinstance(problem, ScenarioProblem) else None
        return Run(
            type(problem.system).__name__ if scenario is None else scenario.name,
            Results(results),
            origins[0].seed,
            versions={"avrare": version.__version__},
            provenance=Provenance(python=platform.python_version(), date=datetime.now(UTC)),
            definition=None if scenario is None else scenario.definition,
            scenario_text="" if scenario is None else dump(scenario.definition.resolved),
        )

    @staticmethod
    def read(folder: str | os.PathLike[str]) -> Run:
        """Read a run folder.

        Raises:
            UsageError: It has no result, or a file in it is damaged.
        """
        hint = "give its path; a report may be of results of avrare.estimate, too"
        path = Path(require_path(folder, "a run folder", hint))
        content = _read_result(path)
        stored = check_model(_StoredRun, content, path / RESULT, RUN_AGAIN)
        check_seal(path / RESULT, content, f"restore the file, or {RUN_AGAIN}")
        loaded = _load_scenario(path)
        failures, samples = read_failures(path), read_rollouts(path)
        artifacts, missing = _read_artifacts(path, stored.files)
        text = _read_scenario_text(path)
        provenance, damage = Provenance.read(path / PROVENANCE)
        call = _describe_command(path, provenance) if text else ""
        results = []
        for entry in stored.estimates:
            name = entry.specification
            origin = Origin(partial(_build, loaded, name), stored.seed, call)
            result = entry.to_result(failures.get(name), samples.get(name), origin)
            left = {file: entries[name] for file, entries in artifacts.items() if name in entries}
            results.append(replace(result, artifacts=left))
        return Run(
            stored.scenario,
            Results(results),
            stored.seed,
            stored.fingerprint,
            stored.versions,
            provenance,
            loaded.definition if isinstance(loaded, LoadedScenario) else None,
            text,
            path,
            stored.files,
            (*_find_changes(path, stored.files, text), *missing, *damage),
        )

    def write(self, folder: str | os.PathLike[str]) -> Run:
        """Write a run folder: result, resolved scenario, provenance, rollouts, failures, artifacts.

        Files of an earlier result in the folder that this one does not write are removed.

        Returns:
            The run with its ``folder``.
        """
        path, results = Path(folder), list(self.values())
        files = _encode_files(self.scenario_text, results)
        run = replace(self, folder=path, files={name: digest(text) for name, text in files.items()})
        hint = "free some disk space and resume the run, or choose another folder"
        with explain_file_errors(f"{path}: cannot write the result", hint):
            path.mkdir(parents=True, exist_ok=True)
            _remove_stale(path, files)
            write_text(path / PROVENANCE, json.dumps(self.provenance.to_dict(), indent=2) + "\n")
            write_failures(path, results)
            write_rollouts(path, results)
            for name, text in files.items():
                write_text(path / name, text)
            write_text(path / RESULT, json.dumps(run.to_dict(), indent=2) + "\n")
        return run

    def to_dict(self) -> dict[str, object]:
        """Return the content of result.json, with its checksum."""
        content = {
            "schema": _SCHEMA,
            "scenario": self.name,
            "fingerprint": self.fingerprint,
            "seed": self.seed,
            "versions": dict(self.versions),
            "estimates": [result.to_dict() for result in self.values()],
            "files": dict(self.files),
        }
        return seal(content)

    @property
    def verdict(self) -> str | None:
        """Worst verdict on the thresholds; None without any."""
        return worst_verdict(result.verdict for result in self.values())

    @property
    def date(self) -> datetime:
        """Time of the result: as its provenance says, else when the file was last changed."""
        if self.provenance.date is not None or self.folder is None:
            return self.provenance.date or datetime.now(UTC)
        return datetime.fromtimestamp((self.folder / RESULT).stat().st_mtime, UTC)

    @property
    def reproduction(self) -> str:
        """Commands or calls that give the numbers again."""
        if self.folder is None or not self.provenance.command:
            calls = {result.origin.call: None for result in self.values() if result.origin is not None}
            return "\n".join(filter(None, calls))
        return _describe_command(self.folder, self.provenance)

    def thresholds(self, specification: str) -> list[Threshold]:
        """List the thresholds that the scenario sets for a specification."""
        thresholds = () if self.definition is None else self.definition.thresholds
        return [threshold for threshold in thresholds if threshold.specification == specification]

    @cached_property
    def problem(self) -> Problem:
        """Problem of all specifications, with its stack built.

        Raises:
            AvrareError: It cannot be built here.
        """
        first = next(iter(self.values())).require_origin().problem
        if isinstance(first, ScenarioProblem):
            return first.scenario.problem(first.scenario.specifications)
        monitors = {name: result.require_origin().problem.monitor(name) for name, result in self.items()}
        return Problem(first.system, monitors, first.steps, chunk=first.named_chunk)

    @property
    def scenario(self) -> LoadedScenario:
        """The scenario with its stack built.

        Raises:
            UsageError: It cannot be built here, or there is none.
        """
        if self.build_errors:
            reason, *further = self.build_errors
            hints = [line.removeprefix("hint: ") for line in further if line.startswith("hint: ")]
            text = f"{self.folder}: its scenario cannot be built: {reason}"
            raise UsageError(text, hints[0] if hints else RUN_AGAIN)
        problem = self.problem
        if not isinstance(problem, ScenarioProblem):
            raise UsageError(f"{self.name} is a problem, not a scenario", "run a scenario file")
        return problem.scenario

    @cached_property
    def build_errors(self) -> tuple[str, ...]:
        """Lines that say why ``problem`` cannot be built; empty where it can be."""
        try:
            _ = self.problem
        except AvrareError as error:
            return tuple(error.lines())
        return ()


def _read_result(path: Path) -> dict[str, object]:
    file = path / RESULT
    if not file.is_file():
        inside = sorted(entry.parent.name for entry in path.glob(f"*/{RESULT}")) if path.is_dir() else []
        hint = f"it holds several runs; give one of them: {', '.join(inside)}" if inside else None
        if (path / "checkpoint" / "checkpoint.json").is_file():
            hint = f"it is not finished: {resume_hint(path)}"
        raise UsageError(
            f"{path}: no {RESULT} in it", hint or "give the folder that `avrare run --out` has written"
        )
    content = read_json(file, RUN_AGAIN)
    if not {"scenario", "estimates", "fingerprint", "seed", "versions"} <= set(content):
        raise UsageError(f"{file}: this is not a result of avrare run", RUN_AGAIN)
    if content.get("schema") != _SCHEMA:
        text = f"{file}: its format is {content.get('schema')}, and this version of avrare reads {_SCHEMA}"
        raise UsageError(text, f"read it with the version that wrote it, or {RUN_AGAIN}")
    return content


def _load_scenario(path: Path) -> LoadedScenario | AvrareError:
    """Return the scenario, or the reason why it cannot be loaded."""
    try:
        return LoadedScenario(load(path / SCENARIO))
    except AvrareError as error:
        return error


def _build(loaded: LoadedScenario | AvrareError, name: str) -> tuple[Problem, Estimator]:
    if isinstance(loaded, AvrareError):
        raise loaded
    return loaded.problem(name), loaded.estimator()


def _describe_command(path: Path, provenance: Provenance) -> str:
    # scenario.yaml contains the seed, but not the budget
    budget = ["--budget", provenance.budget] if provenance.budget else []
    return shlex.join(["avrare", "run", str(path / SCENARIO), *budget])


def _read_scenario_text(path: Path) -> str:
    if is_outside(path / SCENARIO, path):  # a report would give away a file from elsewhere
        return ""
    try:
        return read_regular(path / SCENARIO, MAX_BYTES).decode()
    except (OSError, ValueError):
        return ""


def _find_changes(path: Path, files: Mapping[str, str], text: str) -> tuple[str, ...]:
    if files.get(SCENARIO) in (None, digest(text)):
        return ()
    return (f"{path / SCENARIO}: it was changed after the run, or is missing",)


def _encode_files(scenario_text: str, results: Sequence[Result]) -> dict[str, str]:
    """Return scenario.yaml and the files that estimators leave: each has an entry by specification."""
    entries: dict[str, dict[str, Any]] = {}
    for result in results:
        for name, artifact in result.artifacts.items():
            entries.setdefault(name, {})[result.specification] = artifact
    files = {SCENARIO: scenario_text} if scenario_text else {}
    return files | {name: json.dumps(entries[name], indent=1) + "\n" for name in sorted(entries)}


def _read_artifacts(
    path: Path, files: Mapping[str, str]
) -> tuple[dict[str, dict[str, Any]], tuple[str, ...]]:
    """Return the files that estimators have left, and a line on each that has changed or is missing."""
    artifacts, missing = {}, []
    for name, stored_digest in files.items():
        if name == SCENARIO or Path(name).name != name:
            continue
        try:
            artifacts[name] = read_json(path / name, RUN_AGAIN)
            changed = digest((path / name).read_text()) != stored_digest
        except UsageError:
            changed = True
        if changed:
            missing.append(f"{path / name}: it was changed after the run, or is missing")
    return artifacts, tuple(missing)


def _remove_stale(folder: Path, written: Collection[str]) -> None:
    """Remove the files of an earlier result in ``folder``, except for those that are ``written`` next."""
    file, files = folder / RESULT, None
    if not file.exists():
        return
    with suppress(UsageError):  # a damaged result names no files
        files = read_json(file, RUN_AGAIN).get("files")
    files = list(files) if isinstance(files, dict) else ["learned.json"]
    names = [name for name in files if Path(name).name == name]
    stale = [folder / name for name in names if name not in written]
    # files made from a result, which do not belong to the next one in its folder
    derived = (WHY_FILE, "report.html", "nominal.png", "worst_*.png")
    for path in [*stale, *(path for pattern in derived for path in folder.glob(pattern))]:
        if path.is_file():
            path.unlink()
