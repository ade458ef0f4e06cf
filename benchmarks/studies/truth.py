"""Truth of a scenario: counts of many Monte Carlo rollouts, and the lower tail of each robustness.

A truth is two files, NAME.json (system, counts) and NAME.npz (tails). For each rule the tail holds the least
robust thousandth of all rollouts, sorted, and their numbers, with which they can be driven again. So
P(robustness <= c) is known for every c in the tail, down to a few over the number of rollouts.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.estimation.result.intervals import clopper_pearson

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

TAIL = 1e-3
"""Share of the rollouts that a tail keeps."""


@dataclass(frozen=True)
class Tail:
    """The least robust rollouts of one rule.

    Attributes:
        robustness: (n,), ascending.
        particle: (n,) their numbers: addresses of their noise, in run 0 and stage 0.
        rollouts: Number of all rollouts without an error.
    """

    robustness: Floats
    particle: Integers
    rollouts: int

    @staticmethod
    def of(robustness: Floats, share: float = TAIL) -> Tail:
        """Return the tail of all values (N,); NaN is an error and left out."""
        known = np.flatnonzero(~np.isnan(robustness))
        order = known[np.argsort(robustness[known], kind="stable")][: math.ceil(share * len(known))]
        return Tail(robustness[order], order.astype(np.int64), len(known))

    def probability(self, threshold: float, confidence: float = 0.95) -> tuple[float, tuple[float, float]]:
        """Return P(robustness <= threshold), and its interval by Clopper and Pearson.

        Raises:
            ValueError: The threshold lies above the tail.
        """
        if threshold >= self.robustness[-1] and len(self.robustness) < self.rollouts:
            raise ValueError(f"{threshold:g} is above the tail, which ends at {self.robustness[-1]:g}")
        below = int(np.searchsorted(self.robustness, threshold, side="right"))
        return below / self.rollouts, clopper_pearson(below, self.rollouts, confidence)

    def threshold(self, probability: float) -> float:
        """Return the greatest robustness of the ``probability`` least robust rollouts."""
        count = round(probability * self.rollouts)
        if not 1 <= count <= len(self.robustness):
            raise ValueError(f"{probability:g} of {self.rollouts} rollouts is not in the tail")
        return float(self.robustness[count - 1])


def write(file: Path, about: Mapping[str, Any], tails: Mapping[str, Tail]) -> None:
    """Write ``file`` (JSON) and the tails beside it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    arrays: dict[str, Any] = {}
    for name, tail in tails.items():
        arrays |= {f"{name}.{field}": np.asarray(getattr(tail, field)) for field in _FIELDS}
    np.savez_compressed(file.with_suffix(".npz"), allow_pickle=False, **arrays)


def read_tails(file: Path) -> dict[str, Tail]:
    """Read the tails beside ``file``; none where it has none."""
    path = file.with_suffix(".npz")
    if not path.exists():
        return {}
    with np.load(path) as arrays:
        names = dict.fromkeys(key.rpartition(".")[0] for key in arrays.files)
        return {
            name: Tail(
                arrays[f"{name}.robustness"], arrays[f"{name}.particle"], int(arrays[f"{name}.rollouts"])
            )
            for name in names
        }


_FIELDS = ("robustness", "particle", "rollouts")
