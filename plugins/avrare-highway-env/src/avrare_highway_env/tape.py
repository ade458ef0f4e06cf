"""Random numbers of highway-env from the noise tape."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from avrare.protocols import Floats


class TapeRandom:
    """Replacement of the environment's generator: every draw transforms the next number of the tape.

    Draws beyond the tape come from a generator keyed by the tape's bits, so a rollout depends only on its
    noise.

    Args:
        numbers: Standard normal numbers (K,), consumed from the front.
    """

    def __init__(self, numbers: Floats) -> None:
        self._numbers = numbers
        self.used = 0
        self._rest: np.random.Generator | None = None

    def _next(self) -> float:
        self.used += 1
        if self.used <= len(self._numbers):
            return float(self._numbers[self.used - 1])
        if self._rest is None:
            bits = np.ascontiguousarray(self._numbers, dtype=np.float64).view(np.uint32)
            self._rest = np.random.default_rng([0, *bits.tolist()])
        return float(self._rest.standard_normal())

    def random(self) -> float:
        """Draw from the uniform distribution on [0, 1]."""
        return 0.5 * math.erfc(-self._next() / math.sqrt(2.0))

    def uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """Draw from the uniform distribution on [low, high]."""
        return low + (high - low) * self.random()

    def normal(self, loc: float = 0.0, scale: float = 1.0) -> float:
        """Draw from a normal distribution."""
        return loc + scale * self._next()

    def integers(self, low: int, high: int | None = None) -> int:
        """Draw uniformly from low, ..., high - 1, or 0, ..., low - 1."""
        first, last = (0, low) if high is None else (low, high)
        return min(first + int((last - first) * self.random()), last - 1)

    def choice(self, options: Any, size: int | None = None, replace: bool = True) -> Any:
        """Draw one of the options (``range(options)`` for a number), or an array of ``size`` of them."""
        pool: Sequence[Any] = range(int(options)) if isinstance(options, (int, np.integer)) else options
        if size is None:
            return pool[self.integers(len(pool))]
        left, taken = list(pool), []
        for _ in range(size):
            k = self.integers(len(left))
            taken.append(left[k] if replace else left.pop(k))
        return np.array(taken)
