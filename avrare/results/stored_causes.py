"""Analyses of a run's failures that commands have written into its folder: kinds and attribution."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.base.visible_text import spell_line

KINDS_FILE, ATTRIBUTION_FILE = "kinds.json", "attribution.json"
_AGAIN = "remove it, or write it again with --out"
_Content = TypeVar("_Content", bound=BaseModel)
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
    warnings: list[_Text]
    decisive: _Text = ""
    lost: _Text = ""


class StoredSaving(_Stored):
    """Effect of a perfect part, a row of ``Attribution.savings_table``."""

    perfect: _Text
    saves: float
    low: float | None
    high: float
    vanish: float
    vanish_low: float = 0.0
    vanish_high: float = 1.0
    new: float
    new_high: float


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


class _KindsFile(_Stored):
    kinds: dict[str, StoredKinds]


class _AttributionFile(_Stored):
    attribution: dict[str, StoredAttribution]


def read_kinds(folder: Path) -> dict[str, StoredKinds]:
    """Return the kinds by specification; empty where none were written. UsageError if they cannot be read."""
    return _read(folder / KINDS_FILE, _KindsFile).kinds if (folder / KINDS_FILE).is_file() else {}


def read_attribution(folder: Path) -> dict[str, StoredAttribution]:
    """Return the attributions by specification, likewise."""
    path = folder / ATTRIBUTION_FILE
    return _read(path, _AttributionFile).attribution if path.is_file() else {}


def _read(path: Path, model: type[_Content]) -> _Content:
    try:
        return model.model_validate(read_json(path, _AGAIN))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise UsageError(f"{path}: it cannot be read: {place}: {first['msg']}", _AGAIN) from None
