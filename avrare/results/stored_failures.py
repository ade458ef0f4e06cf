"""Stored failures of a run: the choice among them, and their causes as ``avrare why`` has written them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from avrare.base.errors import UsageError, did_you_mean
from avrare.base.stored_files import read_model
from avrare.base.visible_text import spell_line
from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.results.stored_results import RUN_AGAIN

if TYPE_CHECKING:
    from avrare.results.run import Run


def select_failing(run: Run, specification: str | None = None) -> list[str]:
    """Return the specifications with stored failures, or the one that is named.

    Raises:
        UsageError: There are none.
    """
    if specification is not None and specification not in run:
        hint = did_you_mean(specification, list(run))
        raise UsageError(f"{_place(run)}: there is no specification {specification!r}", hint)
    names = [
        name
        for name, result in run.items()
        if len(result.failures.robustness) and specification in (None, name)
    ]
    if not names:
        raise _explain_absence(run, specification)
    return names


def select_failure(run: Run, specification: str | None, index: int | None) -> tuple[str, int]:
    """Return the specification and the number of one stored failure.

    Without a specification only one may have failures; without an index it is the least robust one.

    Raises:
        UsageError: The failure is not stored.
    """
    names = select_failing(run)
    listing = ", ".join(f"{name} ({len(run[name].failures.robustness)})" for name in names)
    if specification is None and len(names) > 1:
        hint = f"choose a specification: {listing}"
        raise UsageError(f"{_place(run)}: several specifications have failures", hint)
    name = names[0] if specification is None else specification
    if name not in names:
        raise UsageError(f"{_place(run)}: no failure of {name} is stored", f"stored: {listing}")
    robustness = run[name].failures.robustness
    if index is not None and not 0 <= index < len(robustness):
        hint = f"it has {len(robustness)} failures, numbered from 0"
        raise UsageError(f"{_place(run)}: {name} has no failure {index}", hint)
    return name, int(robustness.argmin()) if index is None else index


def _explain_absence(run: Run, specification: str | None) -> UsageError:
    # A rollout that broke down has not failed: more of them would not help.
    results = [result for name, result in run.items() if specification in (None, name)]
    lost = next((result for result in results if result.failures.count), None)
    if lost is not None:
        count = f"{lost.failures.count} failures of {lost.specification}"
        text = f"{_place(run)}: {count} are counted, but not stored"
        return UsageError(text, f"failures.npz is missing, or of another run: restore it, or {RUN_AGAIN}")
    worst = max(results, key=lambda result: result.errors)
    warning = worst.health.get("errors")
    counts = f"{worst.errors} of {worst.rollouts} rollouts ended in an error" if worst.errors else ""
    reason = warning or counts
    text = f"{_place(run)}: no failure{f' of {specification}' if specification else ''} is stored"
    hint = "no rollout failed; run more rollouts, or an estimator for rare events"
    if warning is not None and run.folder is not None:
        command = shlex.join(["avrare", "validate", "--build", str(run.folder / SCENARIO)])
        hint = f"mend the stack and run it again; {command} tries its first steps"
    return UsageError(f"{text}: {reason}" if reason else text, hint)


def _place(run: Run) -> str:
    return run.name if run.folder is None else str(run.folder)


WHY_FILE = "why.json"
_Text = Annotated[str, AfterValidator(spell_line)]


class _Stored(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)


class StoredKind(_Stored):
    """Kind of failure, a row of ``Kinds.table``."""

    kind: int
    probability: float
    low: float
    high: float
    share: float
    representative: int
    text: _Text
    cause: _Text = ""
    warnings: list[_Text]
    severity: _Text = ""
    decisive: _Text = ""
    lost: _Text = ""


class StoredSaving(_Stored):
    """Effect of a change, a row of ``Attribution.savings_table``, in words."""

    perfect: _Text
    text: _Text


class StoredKinds(_Stored):
    """Kinds of one specification; ``probability`` is the estimate that they divide.

    ``points`` are the failures in the plane of their two principal components, ``labels`` their kinds from 0.
    """

    probability: float
    kinds: list[StoredKind]
    points: list[Annotated[list[float], Field(min_length=2, max_length=2)]] = []
    labels: list[int] = []


class StoredAttribution(_Stored):
    """Attribution of one specification."""

    probability: float
    perfect: list[StoredSaving]


_Analysis = TypeVar("_Analysis", StoredKinds, StoredAttribution)


class _WhyFile(_Stored):
    kinds: dict[str, StoredKinds] = {}
    attribution: dict[str, StoredAttribution] = {}


@dataclass(frozen=True)
class StoredCauses:
    """Analyses of a run's failures by specification; ``problem`` says why none can be read."""

    kinds: Mapping[str, StoredKinds] = field(default_factory=dict)
    attribution: Mapping[str, StoredAttribution] = field(default_factory=dict)
    problem: str = ""


def read_causes(folder: Path | None, probabilities: Mapping[str, float]) -> StoredCauses:
    """Return the analyses in a folder that belong to estimates with these probabilities.

    An analysis of another estimate, which an earlier run has left, is left out.
    """
    if folder is None:
        return StoredCauses()
    try:
        stored = _read(folder / WHY_FILE)
    except UsageError as error:
        return StoredCauses(problem=f"{error.message}.")
    return StoredCauses(_select(stored.kinds, probabilities), _select(stored.attribution, probabilities))


def _select(analyses: Mapping[str, _Analysis], probabilities: Mapping[str, float]) -> dict[str, _Analysis]:
    return {
        name: analysis
        for name, analysis in analyses.items()
        if analysis.probability == probabilities.get(name)
    }


def _read(path: Path) -> _WhyFile:
    hint = "remove it, or let the command write it again"
    return read_model(_WhyFile, path, hint) if path.is_file() else _WhyFile()
