"""rollouts.npz in a run's folder: what a report draws beside the failures."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare.estimation.result import Result, Worst
from avrare.record.whole import write_whole

FILE = "rollouts.npz"
MOST = 100_000
"""Rollouts of a specification whose robustness is kept: the first ones."""


@dataclass(frozen=True)
class Sample:
    """What is kept of a specification's rollouts.

    Attributes:
        robustness: (n,) of the first rollouts (of splitting: of its first stage), NaN for errors.
        worst: The least robust rollout.
    """

    robustness: NDArray[np.float32]
    worst: Worst


def write_rollouts(folder: Path, results: Sequence[Result]) -> None:
    """Write robustness and the least robust tape of every result.

    Arrays ``SPECIFICATION.robustness`` (n,), ``.worst`` (steps + 1, noise_size) and ``.worst_robustness`` ().

    Raises:
        OSError: The folder cannot be written to.
    """
    arrays: dict[str, NDArray[np.generic]] = {}
    for result in results:
        name = result.specification
        arrays[f"{name}.robustness"] = _single(result.robustness[:MOST])
        arrays[f"{name}.worst"] = np.asarray(result.worst.noise)
        arrays[f"{name}.worst_robustness"] = np.asarray(result.worst.robustness)
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    write_whole(folder / FILE, content.getvalue())


def read_rollouts(folder: Path) -> dict[str, Sample]:
    """Specification -> its sample; empty where the folder has none.

    Raises:
        UsageError: The file is damaged.
    """
    path = folder / FILE
    if not path.exists():
        return {}
    suffix = ".worst_robustness"
    try:
        with np.load(path, allow_pickle=False) as arrays:
            return {
                name: Sample(
                    arrays[f"{name}.robustness"],
                    Worst(arrays[f"{name}.worst"], float(arrays[f"{name}{suffix}"])),
                )
                for name in (key.removesuffix(suffix) for key in arrays if key.endswith(suffix))
            }
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path}: cannot be read: {error}", "run the scenario again") from None


def _single(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Half the bytes; what is too small for them keeps its sign."""
    with np.errstate(over="ignore", under="ignore"):
        single = np.asarray(values).astype(np.float32)
    lost = (single == 0.0) & (values != 0.0)
    tiny = np.copysign(np.finfo(np.float32).tiny, values)
    return np.where(lost, tiny, single).astype(np.float32)
