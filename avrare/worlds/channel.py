"""Noise that is added to numbers: how large, and of which law."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from avrare.errors import UsageError, did_you_mean
from avrare.protocols import Floats

Law = Literal["normal", "uniform", "laplace"]


def uniform(normal: float) -> float:
    """The standard normal distribution function: a number in [0, 1] from a normal one."""
    return 0.5 * math.erfc(-normal / math.sqrt(2.0))


def _laplace(normal: float) -> float:
    tail = 0.5 * math.erfc(abs(normal) / math.sqrt(2.0))
    return math.copysign(-math.log(max(2.0 * tail, 5e-324)), normal)


@dataclass(frozen=True)
class Channel:
    """Additive noise of ``size`` numbers.

    Attributes:
        size: Numbers it is added to.
        scale: Standard deviation (normal), half width (uniform), mean size (laplace: heavy tails); one for
            all, or one for each.
        law: Of the noise.

    Raises:
        UsageError: There is not one scale for each number, one is below 0, or nobody knows the law.
    """

    size: int
    scale: float | tuple[float, ...] = 1.0
    law: Law = "normal"

    def __post_init__(self) -> None:
        if isinstance(self.scale, tuple) and len(self.scale) != self.size:
            raise UsageError(f"{len(self.scale)} scales for {self.size} numbers", "give one, or one for each")
        if not np.all((np.asarray(self.scale) >= 0.0) & np.isfinite(self.scale)):
            raise UsageError(f"a scale of noise must be 0 or a finite number above it, not {self.scale!r}")
        if self.law not in get_args(Law):
            raise UsageError(f"unknown law {self.law!r} of noise", did_you_mean(self.law, get_args(Law)))

    def __call__(self, normals: Floats) -> Any:
        """What is added, (..., size), from standard normals (..., size)."""
        if self.law == "normal":
            return np.asarray(self.scale) * normals
        shape = _laplace if self.law == "laplace" else (lambda normal: 2.0 * uniform(normal) - 1.0)
        values = [shape(normal) for normal in np.ravel(normals).tolist()]
        return np.asarray(self.scale) * np.reshape(values, np.shape(normals))
