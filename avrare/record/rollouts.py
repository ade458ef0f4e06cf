"""rollouts.npz in a run's folder: what a report draws beside the failures."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare.estimation.result import Result, Worst
from avrare.record.whole import write_whole
from avrare.record.written import read_arrays

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
    arrays, suffix = read_arrays(path), ".worst_robustness"
    names = [key.removesuffix(suffix) for key in arrays if key.endswith(suffix)]
    return {name: _sample(path, name, arrays) for name in names}


def _sample(path: Path, name: str, arrays: Mapping[str, NDArray[Any]]) -> Sample:
    parts = [arrays.get(f"{name}.{part}") for part in ("robustness", "worst", "worst_robustness")]
    axes = [part.ndim if part is not None and part.dtype.kind == "f" else None for part in parts]
    if axes != [1, 2, 0]:
        raise UsageError(f"{path}: cannot be read: {name} is damaged", "run the scenario again")
    robustness, worst, least = parts
    return Sample(robustness, Worst(worst, float(least)))  # type: ignore[arg-type]


def _single(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Half the bytes; what is too small for them keeps its sign."""
    with np.errstate(over="ignore", under="ignore"):
        single = np.asarray(values).astype(np.float32)
    lost = (single == 0.0) & (values != 0.0)
    tiny = np.copysign(np.finfo(np.float32).tiny, values)
    return np.where(lost, tiny, single).astype(np.float32)
