"""failures.npz in a run's folder: the noise of failing rollouts, from which each can be driven again."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError, did_you_mean
from avrare.estimation.result import Failures, Result
from avrare.protocols import Floats
from avrare.record.whole import write_whole
from avrare.record.written import read_arrays

FILE = "failures.npz"
_FIELDS = ("noise", "robustness", "count")


def write_failures(folder: Path, results: Sequence[Result]) -> None:
    """Write the failing tapes of all results; where there are none, no file is left.

    Arrays ``SPECIFICATION.noise`` (F, steps + 1, noise_size), ``.robustness`` (F,) and ``.count`` ().

    Raises:
        OSError: The folder cannot be written to.
    """
    arrays = {
        f"{result.specification}.{field}": np.asarray(getattr(result.failures, field))
        for result in results
        if len(result.failures.robustness)
        for field in _FIELDS
    }
    if not arrays:
        (folder / FILE).unlink(missing_ok=True)  # of an earlier run in the same folder
        return
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    write_whole(folder / FILE, content.getvalue())


def read_failures(folder: Path) -> dict[str, Failures]:
    """Specification -> its failing tapes; empty where nothing failed.

    Raises:
        UsageError: The file is damaged.
    """
    path = folder / FILE
    if not path.exists():
        return {}
    arrays = read_arrays(path)
    names = [key.removesuffix(".noise") for key in arrays if key.endswith(".noise")]
    return {name: _failures(path, name, arrays) for name in names}


def _failures(path: Path, name: str, arrays: Mapping[str, NDArray[Any]]) -> Failures:
    noise, robustness, count = (arrays.get(f"{name}.{field}", np.zeros(())) for field in _FIELDS)
    kinds = [array.dtype.kind for array in (noise, robustness, count)]
    fit = noise.ndim == 3 and robustness.shape == noise.shape[:1] and count.shape == ()
    if not fit or not len(noise) or kinds != ["f", "f", "i"] or not np.isfinite(noise).all():
        raise UsageError(f"{path}: cannot be read: {name} is damaged", "run the scenario again")
    return Failures(noise, robustness, int(count))


def chosen_failure(
    folder: Path, specification: str | None = None, index: int | None = None
) -> tuple[str, Floats, float]:
    """Specification, noise (steps + 1, noise_size) and robustness of a failure of a run.

    Args:
        folder: Of the run.
        specification: Whose failure; None where only one has any.
        index: Which of the stored ones; None for the one with the least robustness.

    Raises:
        UsageError: There is no such failure.
    """
    stored = read_failures(folder)
    listing = ", ".join(f"{name} ({len(found.robustness)})" for name, found in stored.items())
    if not stored:
        raise UsageError(f"{folder}: no failure is stored", "none was seen; run more rollouts")
    if specification is None and len(stored) > 1:
        raise UsageError(f"{folder}: whose failure?", f"choose it with --specification: {listing}")
    name = next(iter(stored)) if specification is None else specification
    if name not in stored:
        raise UsageError(f"{folder}: no failure of {name!r} is stored", did_you_mean(name, stored))
    failures = stored[name]
    count = len(failures.robustness)
    if index is not None and index >= count:
        raise UsageError(f"{folder}: {name} has no failure {index}", f"its {count} failures count from 0")
    chosen = int(np.argmin(failures.robustness)) if index is None else index
    return name, failures.noise[chosen], float(failures.robustness[chosen])


def versions(folder: Path) -> dict[str, str]:
    """Versions of avrare and of the plugins with which a run was made, as result.json has them.

    Raises:
        UsageError: The file is damaged.
    """
    path = folder / "result.json"
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))["versions"]
        return {str(name): str(version) for name, version in stored.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(f"{path}: cannot be read: {error}", "run the scenario again") from None
