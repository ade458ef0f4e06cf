"""What a run's folder holds, read back: result.json, the other JSON files, and arrays."""

from __future__ import annotations

import json
import shlex
import zipfile
import zlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from avrare.errors import UsageError

_AGAIN = "run the scenario again"
_Share = Annotated[float, Field(ge=0.0, le=1.0)]


class _Estimate(BaseModel):
    """What every reader relies on; there may be more."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)

    specification: str
    estimator: str
    probability: _Share
    interval: Annotated[list[_Share], Field(min_length=2, max_length=2)]
    confidence: _Share
    relative_error: float | None
    rollouts: int
    simulated_steps: int
    failures: int
    errors: int
    seconds: float
    health: list[str]
    verdict: Literal["pass", "fail", "inconclusive"] | None
    warnings: dict[str, str] | None = None
    counts: dict[str, float] | None = None
    run_probabilities: list[float | None] | None = None
    diagnostics: dict[str, Any] | None = None


class _Content(BaseModel):
    model_config = ConfigDict(strict=True)

    scenario: str
    fingerprint: str
    seed: int
    versions: dict[str, str]
    estimates: Annotated[list[_Estimate], Field(min_length=1)]


def read_result(path: Path) -> dict[str, Any]:
    """The content of a run's result.json.

    Raises:
        UsageError: There is none, or it is damaged.
    """
    file = path / "result.json"
    if not file.is_file():
        inside = sorted(one.parent.name for one in path.glob("*/result.json")) if path.is_dir() else []
        hint = f"it holds several runs; give one of them: {', '.join(inside)}" if inside else None
        if (path / "checkpoint").is_dir():
            hint = f"it is not finished: avrare run --resume {shlex.quote(str(path))} goes on with it"
        raise UsageError(
            f"{path}: no result.json in it", hint or "give the folder that `avrare run --out` has written"
        )
    content = read_json(file)
    if not {"scenario", "estimates", "fingerprint", "seed", "versions"} <= set(content):
        raise UsageError(f"{file}: this is no result of avrare run", _AGAIN)
    try:
        _Content.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise UsageError(f"{file}: it cannot be read: {place}: {first['msg']}", _AGAIN) from None
    return content


def written_at(path: Path) -> datetime:
    """When a run's result was written: as its provenance says, else when the file was last changed."""
    origin = path / "provenance.json"
    date = read_json(origin).get("date") if origin.is_file() else None
    try:
        return datetime.fromisoformat(str(date)).astimezone(UTC)
    except (ValueError, OverflowError):
        return datetime.fromtimestamp((path / "result.json").stat().st_mtime, UTC)


def read_json(path: Path) -> dict[str, Any]:
    """A file that holds a JSON object.

    Raises:
        UsageError: It cannot be read, or holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UsageError(f"{path}: cannot be read: {error}", _AGAIN) from None
    if not isinstance(content, dict):
        raise UsageError(f"{path}: this is no JSON object", _AGAIN)
    return content


def read_arrays(path: Path, hint: str = _AGAIN) -> dict[str, NDArray[Any]]:
    """All arrays of an npz file; nothing is ever unpickled.

    Args:
        path: Of the file.
        hint: What to do where it is damaged.

    Raises:
        UsageError: The file is damaged, or is another kind of file.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {str(name): np.asarray(stored[name]) for name in stored}
    except (
        OSError, ValueError, KeyError, TypeError, EOFError, MemoryError, RuntimeError,
        zipfile.BadZipFile, zlib.error,
    ) as error:  # fmt: skip
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        if "pickle" in reason:  # NumPy's advice is to trust the file
            reason = "it holds something else than arrays"
        raise UsageError(f"{path}: cannot be read: {reason}", hint) from None
