"""Reader of a run folder: its files, checked once and given as typed frozen values.

Whatever cannot be read raises ``UsageError``; missing provenance, failures and rollouts are no errors.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from avrare.base.errors import AvrareError, UsageError, did_you_mean
from avrare.base.stored_files import check_seal, digest, read_arrays, read_json, read_regular
from avrare.base.visible_text import spell_line
from avrare.estimation.checkpoint import SCENARIO, resume_hint
from avrare.estimation.note import Note
from avrare.estimation.result import Failures, Worst
from avrare.results.stored_diagnostics import check_diagnostics
from avrare.scenario.safe_mode import is_outside
from avrare.scenario.yaml import MAX_BYTES

if TYPE_CHECKING:
    from avrare.rollout.loaded_scenario import LoadedScenario
    from avrare.scenario.schema import Scenario, Threshold

RUN_AGAIN = "run the scenario again"
FAILURES_FILE, FAILURE_FIELDS = "failures.npz", ("noise", "robustness", "count")
SAMPLE_LAW = ("weights", "ancestors")
"""Further fields of the failures, of estimators whose failures are not independent and alike."""
ROLLOUTS_FILE, SAMPLE_FIELDS = "rollouts.npz", ("worst_robustness", "robustness", "worst")
_Stored = TypeVar("_Stored")
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_Name = Annotated[str, AfterValidator(spell_line)]


@dataclass(frozen=True)
class RolloutSample:
    """Stored rollouts of one specification.

    ``robustness`` (n,) is of the first rollouts (in splitting: of the first stage), NaN for errors.
    """

    robustness: NDArray[np.float32]
    worst: Worst


class StoredEstimate(BaseModel):
    """Entry of result.json: the fields that readers rely on (``Result.to_dict`` writes more)."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)

    specification: _Name
    estimator: _Name
    probability: _Share
    interval: Annotated[tuple[_Share, _Share], Field(strict=False)]
    confidence: _Share
    relative_error: float | None
    rollouts: int
    simulated_steps: int
    failures: int
    errors: int
    seconds: float
    health: list[_Name]
    notes: list[Note]
    verdict: Literal["pass", "fail", "inconclusive"] | None
    blind_bound: _Share | None = None
    warnings: dict[str, str] | None = None
    run_probabilities: list[float | None] | None = None
    diagnostics: Annotated[dict[str, Any] | None, AfterValidator(check_diagnostics)] = None


class StoredResult(BaseModel):
    """Content of result.json."""

    model_config = ConfigDict(strict=True, frozen=True)

    scenario: _Name
    fingerprint: _Name
    seed: int
    versions: dict[_Name, _Name]
    estimates: Annotated[list[StoredEstimate], Field(min_length=1)]
    files: dict[str, str] = {}


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
        content = read_json(file, RUN_AGAIN) if file.is_file() else {}
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
        if self.provenance.date is not None:
            return self.provenance.date
        return datetime.fromtimestamp((self.path / "result.json").stat().st_mtime, UTC)

    @property
    def reproduction(self) -> str:
        """Command that gives the numbers again."""
        # scenario.yaml contains the seed, but not the budget
        budget = ["--budget", self.provenance.budget] if self.provenance.budget else []
        return shlex.join(["avrare", "run", str(self.path / SCENARIO), *budget])

    def estimator(self, specification: str) -> Any:
        """Build the estimator of a specification; the scenario can be built."""
        assert self.scenario is not None, specification
        return self.scenario.estimator()

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

    def require_scenario(self) -> LoadedScenario:
        """Return the scenario with its stack built; a ``UsageError`` says why it cannot be."""
        if self.scenario is None:
            reason, *further = self.load_errors
            hint = next((line.removeprefix("hint: ") for line in further if line.startswith("hint: ")), None)
            raise UsageError(f"{self.path}: its scenario cannot be built: {reason}", hint or RUN_AGAIN)
        return self.scenario

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
        return _scenario_text(self.path)

    @property
    def changes(self) -> tuple[str, ...]:
        """Lines on what is not as the run has left it."""
        return _find_changes(self.path, self.content)

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
        if (path / "checkpoint" / "checkpoint.json").is_file():
            hint = f"it is not finished: {resume_hint(path)}"
        raise UsageError(
            f"{path}: no result.json in it", hint or "give the folder that `avrare run --out` has written"
        )
    content = read_json(file, RUN_AGAIN)
    if not {"scenario", "estimates", "fingerprint", "seed", "versions"} <= set(content):
        raise UsageError(f"{file}: this is not a result of avrare run", RUN_AGAIN)
    try:
        result = StoredResult.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise UsageError(f"{file}: it cannot be read: {place}: {first['msg']}", RUN_AGAIN) from None
    check_seal(file, content, f"restore the file, or {RUN_AGAIN}")
    return RunFolder(path, content, result)


def read_versions(path: Path) -> dict[str, str]:
    """Return the versions with which a run was made; nothing else in its result.json is checked."""
    versions = read_json(path / "result.json", RUN_AGAIN).get("versions")
    if not isinstance(versions, dict):
        raise UsageError(f"{path / 'result.json'}: cannot be read: it names no versions", RUN_AGAIN)
    return {str(name): str(version) for name, version in versions.items()}


def load_run_scenario(path: Path) -> LoadedScenario:
    """Load the scenario of a run folder."""
    from avrare.rollout.loaded_scenario import load

    file = path / SCENARIO
    if not file.is_file():
        raise UsageError(f"{path}: no scenario.yaml in it", "give the folder that `avrare run` has written")
    return load(file)


def find_changes(path: Path) -> tuple[str, ...]:
    """Return lines on what is not as the run has left it in its folder."""
    file = path / "result.json"
    return _find_changes(path, read_json(file, RUN_AGAIN)) if file.is_file() else ()


def _find_changes(path: Path, content: Mapping[str, Any]) -> tuple[str, ...]:
    files = content.get("files")
    written = files.get(SCENARIO) if isinstance(files, dict) else None
    if written in (None, digest(_scenario_text(path))):
        return ()
    return (f"{path / SCENARIO}: it was changed after the run, or is missing",)


def _scenario_text(path: Path) -> str:
    if is_outside(path / SCENARIO, path):  # a report would give away a file from elsewhere
        return ""
    try:
        return read_regular(path / SCENARIO, MAX_BYTES).decode()
    except (OSError, ValueError):
        return ""


def _date(text: Any) -> datetime | None:
    try:
        return datetime.fromisoformat(str(text)).astimezone(UTC)
    except (ValueError, OverflowError):
        return None


def read_failures(folder: Path) -> dict[str, Failures]:
    """Return the stored failures of each specification; empty where nothing failed."""
    return _read(folder / FAILURES_FILE, (*FAILURE_FIELDS, *SAMPLE_LAW), _to_failures)


def read_rollouts(folder: Path) -> dict[str, RolloutSample]:
    """Return the stored rollouts of each specification; empty where the folder has none."""
    return _read(folder / ROLLOUTS_FILE, SAMPLE_FIELDS, _to_sample)


def _read(path: Path, fields: Sequence[str], convert: Callable[..., _Stored | None]) -> dict[str, _Stored]:
    arrays, suffix, found = read_arrays(path, RUN_AGAIN) if path.exists() else {}, f".{fields[0]}", {}
    for name in [key.removesuffix(suffix) for key in arrays if key.endswith(suffix)]:
        stored = convert(*(arrays.get(f"{name}.{field}", np.array("missing")) for field in fields))
        if stored is None:
            raise UsageError(f"{path}: cannot be read: {name} is damaged", RUN_AGAIN)
        found[name] = stored
    return found


def _to_failures(
    noise: NDArray[Any], robustness: NDArray[Any], count: NDArray[Any], *law: NDArray[Any]
) -> Failures | None:
    fit = noise.ndim == 3 and robustness.shape == noise.shape[:1] and count.shape == ()
    types = noise.dtype == robustness.dtype == np.float64 and count.dtype.kind == "i"
    valid = fit and types and len(noise) and np.isfinite(noise).all() and not np.isnan(robustness).any()
    weights, ancestors = (None if array.dtype.kind == "U" else array for array in law)
    if weights is not None:
        valid = valid and weights.shape == robustness.shape and weights.dtype == np.float64
        valid = valid and bool((weights >= 0.0).all())
    if ancestors is not None:
        valid = valid and ancestors.shape == (len(noise), 2) and ancestors.dtype.kind == "i"
    return Failures(noise, robustness, int(count), weights, ancestors) if valid else None


def _to_sample(least: NDArray[Any], robustness: NDArray[Any], worst: NDArray[Any]) -> RolloutSample | None:
    axes = [(array.dtype.kind, array.ndim) for array in (least, robustness, worst)]
    valid = axes == [("f", 0), ("f", 1), ("f", 2)]
    return RolloutSample(robustness, Worst(worst, float(least))) if valid else None


def select_specifications(folder: RunFolder, specification: str | None) -> list[str]:
    """Return the specifications of a run that have stored failures, or the one that is named."""
    known = [one.specification for one in folder.result.estimates]
    if specification is not None and specification not in known:
        hint = did_you_mean(specification, known)
        raise UsageError(f"{folder.path}: there is no specification {specification!r}", hint)
    found = [name for name in known if name in folder.failures and specification in (None, name)]
    if not found:
        raise _explain_absence(folder, specification)
    return found


def _explain_absence(folder: RunFolder, specification: str | None) -> UsageError:
    # An error is no failure: where rollouts broke down, more of them would not help.
    estimates = [one for one in folder.result.estimates if specification in (None, one.specification)]
    worst = max(estimates, key=lambda one: one.errors)
    warning = (worst.warnings or {}).get("errors")
    counts = f"{worst.errors} of {worst.rollouts} rollouts ended in an error" if worst.errors else ""
    reason = warning or counts
    text = f"{folder.path}: no failure{f' of {specification}' if specification else ''} is stored"
    hint = "no rollout failed; run more rollouts, or an estimator for rare events"
    if warning is not None:
        command = shlex.join(["avrare", "validate", "--build", str(folder.path / SCENARIO)])
        hint = f"mend the stack and run it again; {command} tries its first steps"
    return UsageError(f"{text}: {reason}" if reason else text, hint)


def select_failure(
    folder: Path, stored: Mapping[str, Failures], specification: str | None, index: int | None
) -> tuple[str, int]:
    """Return the specification and the number of one stored failure of a run.

    Without a specification only one may have failures; without an index it is the least robust one.
    """
    if not stored:
        raise _explain_absence(read_run_folder(folder), None)
    listing = ", ".join(f"{name} ({len(found.robustness)})" for name, found in stored.items())
    if specification is None and len(stored) > 1:
        hint = f"choose one with --specification: {listing}"
        raise UsageError(f"{folder}: several specifications have failures", hint)
    name = next(iter(stored)) if specification is None else specification
    if name not in stored:
        raise UsageError(f"{folder}: no failure of {name} is stored", f"stored: {listing}")
    count = len(stored[name].robustness)
    if index is not None and not 0 <= index < count:
        hint = f"it has {count} failures, numbered from 0"
        raise UsageError(f"{folder}: {name} has no failure {index}", hint)
    return name, int(np.argmin(stored[name].robustness)) if index is None else index
