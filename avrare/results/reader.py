"""Reader of a run folder: its files, checked once and given as typed frozen values.

Whatever cannot be read raises ``UsageError``; missing provenance, failures and rollouts are no errors.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from avrare.base.errors import AvrareError, UsageError
from avrare.estimation.checkpoint import SCENARIO
from avrare.estimation.result import Failures
from avrare.results.stored_rollouts import RUN_AGAIN, RolloutSample, read_failures, read_rollouts

if TYPE_CHECKING:
    from avrare.rollout.loaded_scenario import LoadedScenario
    from avrare.scenario.schema import Scenario, Threshold

_Share = Annotated[float, Field(ge=0.0, le=1.0)]


class StoredEstimate(BaseModel):
    """Entry of result.json: the fields that readers rely on (``Result.to_dict`` writes more)."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)

    specification: str
    estimator: str
    probability: _Share
    interval: Annotated[tuple[_Share, _Share], Field(strict=False)]
    confidence: _Share
    relative_error: float | None
    rollouts: int
    simulated_steps: int
    failures: int
    errors: int
    seconds: float
    health: list[str]
    verdict: Literal["pass", "fail", "inconclusive"] | None
    blind_bound: _Share | None = None
    warnings: dict[str, str] | None = None
    counts: dict[str, int | float] | None = None
    run_probabilities: list[float | None] | None = None
    diagnostics: dict[str, Any] | None = None


class StoredResult(BaseModel):
    """Content of result.json."""

    model_config = ConfigDict(strict=True, frozen=True)

    scenario: str
    fingerprint: str
    seed: int
    versions: dict[str, str]
    estimates: Annotated[list[StoredEstimate], Field(min_length=1)]


@dataclass(frozen=True)
class Provenance:
    """Origin of a run, from provenance.json; empty where it is not recorded.

    ``budget`` is ``KIND=AMOUNT``, None where the estimator's own options decided. ``commit`` and
    ``uncommitted_changes`` are of the scenario's folder.
    """

    command: tuple[str, ...] = ()
    budget: str | None = None
    python: str | None = None
    commit: str = ""
    uncommitted_changes: bool = False
    date: datetime | None = None


@dataclass(frozen=True)
class RunFolder:
    """Folder that ``avrare run`` has written; each file is read when it is first asked for.

    ``result`` is ``content``, the JSON object in result.json, with types.
    """

    path: Path
    content: dict[str, Any]
    result: StoredResult

    @cached_property
    def provenance(self) -> Provenance:
        """Content of provenance.json."""
        file = self.path / "provenance.json"
        content = read_json(file) if file.is_file() else {}
        budget, python, command = (content.get(key) for key in ("budget", "python", "command"))
        return Provenance(
            command=tuple(map(str, command)) if isinstance(command, list) else (),
            budget=str(budget) if budget else None,
            python=None if python is None else str(python),
            commit=str(content.get("commit") or ""),
            uncommitted_changes=bool(content.get("uncommitted_changes")),
            date=_date(content.get("date")),
        )

    @property
    def written(self) -> datetime:
        """Time of the result: as its provenance says, else when the file was last changed."""
        changed = (self.path / "result.json").stat().st_mtime
        return self.provenance.date or datetime.fromtimestamp(changed, UTC)

    def thresholds(self, specification: str) -> list[Threshold]:
        """List the thresholds that the scenario sets for a specification."""
        known = () if self.definition is None else self.definition.thresholds
        return [one for one in known if one.specification == specification]

    @property
    def definition(self) -> Scenario | None:
        """The scenario, loaded anew; None where it cannot be loaded any more."""
        return self._loaded[0]

    @property
    def scenario(self) -> LoadedScenario | None:
        """The scenario with its stack built; None where it cannot be built here."""
        return self._loaded[1]

    @property
    def load_errors(self) -> tuple[str, ...]:
        """Lines that say why ``scenario`` is None; empty where it is not."""
        return self._loaded[2]

    @cached_property
    def _loaded(self) -> tuple[Scenario | None, LoadedScenario | None, tuple[str, ...]]:
        from avrare.rollout.loaded_scenario import LoadedScenario
        from avrare.scenario.load import load

        definition = None
        try:
            definition = load(self.path / SCENARIO)
            scenario = LoadedScenario(definition)
            _ = scenario.stack
        except AvrareError as error:
            return definition, None, tuple(error.lines())
        return definition, scenario, ()

    @cached_property
    def scenario_text(self) -> str:
        """The resolved scenario as YAML; empty where it cannot be read."""
        try:
            return (self.path / SCENARIO).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            return ""

    @cached_property
    def failures(self) -> Mapping[str, Failures]:
        """Stored failures of each specification."""
        return read_failures(self.path)

    @cached_property
    def samples(self) -> Mapping[str, RolloutSample]:
        """Stored rollouts of each specification."""
        return read_rollouts(self.path)


def read_run_folder(path: Path) -> RunFolder:
    """Read the result of a run folder."""
    file = path / "result.json"
    if not file.is_file():
        inside = sorted(one.parent.name for one in path.glob("*/result.json")) if path.is_dir() else []
        hint = f"it holds several runs; give one of them: {', '.join(inside)}" if inside else None
        if (path / "checkpoint").is_dir():
            hint = f"the run is not finished: avrare run --resume {shlex.quote(str(path))} resumes it"
        raise UsageError(
            f"{path}: no result.json in it", hint or "give the folder that `avrare run --out` has written"
        )
    content = read_json(file)
    if not {"scenario", "estimates", "fingerprint", "seed", "versions"} <= set(content):
        raise UsageError(f"{file}: this is not a result of avrare run", RUN_AGAIN)
    try:
        result = StoredResult.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise UsageError(f"{file}: it cannot be read: {place}: {first['msg']}", RUN_AGAIN) from None
    return RunFolder(path, content, result)


def read_versions(path: Path) -> dict[str, str]:
    """Return the versions with which a run was made; nothing else in its result.json is checked."""
    versions = read_json(path / "result.json").get("versions")
    if not isinstance(versions, dict):
        raise UsageError(f"{path / 'result.json'}: cannot be read: it names no versions", RUN_AGAIN)
    return {str(name): str(version) for name, version in versions.items()}


def load_run_scenario(path: Path) -> LoadedScenario:
    """Load the scenario of a run folder."""
    from avrare.rollout.loaded_scenario import LoadedScenario
    from avrare.scenario.load import load

    file = path / SCENARIO
    if not file.is_file():
        raise UsageError(f"{path}: no scenario.yaml in it", "give the folder that `avrare run` has written")
    return LoadedScenario(load(file))


def _date(text: Any) -> datetime | None:
    try:
        return datetime.fromisoformat(str(text)).astimezone(UTC)
    except (ValueError, OverflowError):
        return None


def read_json(path: Path) -> dict[str, Any]:
    """Read a file that holds a JSON object."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UsageError(f"{path}: cannot be read: {error}", RUN_AGAIN) from None
    if not isinstance(content, dict):
        raise UsageError(f"{path}: this is not a JSON object", RUN_AGAIN)
    return content
