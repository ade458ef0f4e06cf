"""Causes of a run's failures, as ``avrare why`` has written them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_model
from avrare.base.visible_text import spell_line

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
