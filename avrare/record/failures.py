"""failures.npz in a run's folder: the noise of failing rollouts, from which each can be driven again."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from avrare.errors import UsageError
from avrare.estimation.result import Failures, Result
from avrare.record.whole import write_whole

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
    try:
        with np.load(path, allow_pickle=False) as arrays:
            names = [key.removesuffix(".noise") for key in arrays if key.endswith(".noise")]
            found = {name: [arrays[f"{name}.{field}"] for field in _FIELDS] for name in names}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path}: cannot be read: {error}", "run the scenario again") from None
    return {
        name: Failures(noise, robustness, int(count)) for name, (noise, robustness, count) in found.items()
    }
