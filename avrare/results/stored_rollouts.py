"""Rollouts stored in a run folder: failing noise tapes (failures.npz) and a sample of all (rollouts.npz)."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.base.files import write_atomic
from avrare.estimation.result import Failures, Result, Worst

FAILURES_FILE = "failures.npz"
ROLLOUTS_FILE = "rollouts.npz"
MAX_SAMPLES = 100_000
"""Stored robustness values of a specification: those of its first rollouts."""
RUN_AGAIN = "run the scenario again"
_Stored = TypeVar("_Stored")
_FAILURE_FIELDS = ("noise", "robustness", "count")
_SAMPLE_FIELDS = ("worst_robustness", "robustness", "worst")


@dataclass(frozen=True)
class RolloutSample:
    """Stored rollouts of one specification.

    ``robustness`` (n,) is of the first rollouts (in splitting: of the first stage), NaN for errors.
    """

    robustness: NDArray[np.float32]
    worst: Worst


def write_failures(folder: Path, results: Sequence[Result]) -> None:
    """Write the failing tapes of all results; remove the file where there are none.

    Arrays ``SPECIFICATION.noise`` (F, steps + 1, noise_size), ``.robustness`` (F,) and ``.count`` ().
    """
    arrays = {
        f"{result.specification}.{field}": np.asarray(getattr(result.failures, field))
        for result in results
        if len(result.failures.robustness)
        for field in _FAILURE_FIELDS
    }
    if not arrays:
        (folder / FAILURES_FILE).unlink(missing_ok=True)  # left by an earlier run in the same folder
        return
    _write(folder / FAILURES_FILE, np.savez, arrays)


def write_rollouts(folder: Path, results: Sequence[Result]) -> None:
    """Write robustness and the least robust tape of every result.

    Arrays ``SPECIFICATION.robustness`` (n,), ``.worst`` (steps + 1, noise_size) and ``.worst_robustness`` ().
    """
    arrays: dict[str, NDArray[np.generic]] = {}
    for result in results:
        name = result.specification
        arrays[f"{name}.robustness"] = _to_single(result.robustness[:MAX_SAMPLES])
        arrays[f"{name}.worst"] = np.asarray(result.worst.noise)
        arrays[f"{name}.worst_robustness"] = np.asarray(result.worst.robustness)
    _write(folder / ROLLOUTS_FILE, np.savez_compressed, arrays)


def _write(path: Path, save: Callable[..., None], arrays: Mapping[str, NDArray[Any]]) -> None:
    content = io.BytesIO()
    save(content, **arrays)
    write_atomic(path, content.getvalue())


def _to_single(values: NDArray[np.float64]) -> NDArray[np.float32]:
    with np.errstate(over="ignore", under="ignore"):
        single = np.asarray(values).astype(np.float32)
    # a value that underflows keeps its sign, which tells failures apart
    lost = (single == 0.0) & (values != 0.0)
    tiny = np.copysign(np.finfo(np.float32).tiny, values)
    return np.where(lost, tiny, single).astype(np.float32)


def read_failures(folder: Path) -> dict[str, Failures]:
    """Return the stored failures of each specification; empty where nothing failed."""
    return _read(folder / FAILURES_FILE, _FAILURE_FIELDS, _to_failures)


def read_rollouts(folder: Path) -> dict[str, RolloutSample]:
    """Return the stored rollouts of each specification; empty where the folder has none."""
    return _read(folder / ROLLOUTS_FILE, _SAMPLE_FIELDS, _to_sample)


def _read(path: Path, fields: Sequence[str], convert: Callable[..., _Stored | None]) -> dict[str, _Stored]:
    arrays, suffix, found = read_arrays(path) if path.exists() else {}, f".{fields[0]}", {}
    for name in [key.removesuffix(suffix) for key in arrays if key.endswith(suffix)]:
        stored = convert(*(arrays.get(f"{name}.{field}", np.array("missing")) for field in fields))
        if stored is None:
            raise UsageError(f"{path}: cannot be read: {name} is damaged", RUN_AGAIN)
        found[name] = stored
    return found


def _to_failures(noise: NDArray[Any], robustness: NDArray[Any], count: NDArray[Any]) -> Failures | None:
    kinds = [array.dtype.kind for array in (noise, robustness, count)]
    fit = noise.ndim == 3 and robustness.shape == noise.shape[:1] and count.shape == ()
    valid = fit and len(noise) and kinds == ["f", "f", "i"] and np.isfinite(noise).all()
    return Failures(noise, robustness, int(count)) if valid else None


def _to_sample(least: NDArray[Any], robustness: NDArray[Any], worst: NDArray[Any]) -> RolloutSample | None:
    axes = [(array.dtype.kind, array.ndim) for array in (least, robustness, worst)]
    valid = axes == [("f", 0), ("f", 1), ("f", 2)]
    return RolloutSample(robustness, Worst(worst, float(least))) if valid else None


def select_failure(
    folder: Path, stored: Mapping[str, Failures], specification: str | None, index: int | None
) -> tuple[str, int]:
    """Return the specification and the number of one stored failure of a run.

    Without a specification only one may have failures; without an index it is the least robust one.
    """
    listing = ", ".join(f"{name} ({len(found.robustness)})" for name, found in stored.items())
    if not stored:
        hint = "no rollout failed; run more rollouts, or an estimator for rare events"
        raise UsageError(f"{folder}: no failure is stored", hint)
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


def read_arrays(path: Path, hint: str = RUN_AGAIN) -> dict[str, NDArray[Any]]:
    """Read all arrays of an npz file; nothing is ever unpickled."""
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
