"""Values and causes of ``always`` formulas on long recordings, a stretch of samples at a time.

A stretch is evaluated with as many samples before and after it as the formula looks back and ahead, so that
its values are those of the whole recording; memory is that of a stretch.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic.explanation import Explanation
from avrare.logic.formula import Formula
from avrare.logic.syntax import nodes
from avrare.protocols import Bools, Floats

Inputs = Mapping[str, NDArray[Any]]

LARGE = 2_000_000
"""Samples times pairs of vehicles above which a recording is evaluated in stretches."""

_STRETCH = 100_000  # samples times pairs of vehicles at a time


@dataclass(frozen=True)
class Stretches:
    """An ``always`` formula's body on a recording.

    Attributes:
        formula: The whole formula.
        body: Formula that must hold at every sample.
        read: Function (first, last + 1) -> inputs (1, samples, ...) of the formula.
        samples: Number of samples of the recording.
        vehicles: Number of other vehicles.
    """

    formula: Formula
    body: nodes.Node
    read: Callable[[int, int], Inputs]
    samples: int
    vehicles: int

    @property
    def reads_all(self) -> bool:
        """Return whether to read the whole recording: it is small, or the body needs all of it anyway."""
        return self.is_unbounded or self.samples * self.vehicles**2 <= LARGE

    @property
    def is_unbounded(self) -> bool:
        """Return whether the body depends on arbitrarily early or late samples."""
        return math.isinf(self._alone.horizon) or math.isinf(self._alone.history)

    @property
    def _alone(self) -> Formula:
        return dataclasses.replace(self.formula, derived=self.body)

    def evaluate(self) -> tuple[Floats, Bools]:
        """Return the body's robustness and truth (samples,)."""
        robustness, truth = np.empty(self.samples), np.empty(self.samples, dtype=np.bool_)
        length = max(1, _STRETCH // max(1, self.vehicles**2))
        for begin in range(0, self.samples, length):
            end = min(begin + length, self.samples)
            first, inputs = self.around(begin, end)
            inner = slice(begin - first, end - first)
            robustness[begin:end] = self._alone.robustness(inputs)[0][inner]
            truth[begin:end] = self._alone.satisfied(inputs)[0][inner]
        return robustness, truth

    def around(self, begin: int, end: int) -> tuple[int, Inputs]:
        """Return the inputs that decide samples ``begin`` to ``end - 1``, and the first sample of them."""
        first = max(0, begin - int(self._alone.history))
        return first, self.read(first, min(self.samples, end + int(self._alone.horizon)))

    def explain(self, sample: int, members: dict[str, tuple[str, ...]]) -> tuple[int, Inputs, Explanation]:
        """Explain the body at one sample; the explanation's samples count from the first that is returned."""
        first, inputs = self.around(sample, sample + 1)
        here = nodes.Window("always", sample - first, sample - first, self.body)
        return first, inputs, dataclasses.replace(self.formula, derived=here).explain(inputs, members)
