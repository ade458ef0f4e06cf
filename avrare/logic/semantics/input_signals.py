"""Input checks: signals from the user, laid out for evaluation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from avrare.base.errors import FormulaError, did_you_mean
from avrare.logic.semantics.window_operators import Array

_FLOAT = np.dtype(np.float64)


@dataclass(frozen=True)
class Trace:
    """Checked signals over time.

    Attributes:
        samples: name -> (T, N, ...), views of the user's arrays.
        steps: T.
        rows: N.
        single: True if the user gave (T,) arrays, one trace without a batch axis.
    """

    samples: dict[str, Array]
    steps: int
    rows: int
    single: bool

    def at(self, t: int) -> dict[str, Array]:
        """Return sample ``t``, (N, ...) each."""
        return {name: x[t] for name, x in self.samples.items()}

    def blocks(self) -> list[slice]:
        """Split the rows into blocks of similar size whose arrays fit the processor's cache."""
        size = max(x[:, :1].size for x in self.samples.values()) if self.rows else 1
        # numbers of an array that fit the processor's cache
        rows, most = max(self.rows, 1), max(1, 14_000 // max(size, 1))
        count = math.ceil(rows / math.ceil(rows / most))
        return [slice(first, first + count) for first in range(0, rows, count)]

    def take(self, rows: slice) -> Trace:
        """Return the traces ``rows``."""
        samples = {name: x[:, rows] for name, x in self.samples.items()}
        return Trace(samples, self.steps, next(iter(samples.values())).shape[1], self.single)


def read_trace(signals: Mapping[str, object], names: Sequence[str]) -> Trace:
    """Check the signals ``names`` of complete traces, (N, T, ...) each or (T,) each; NaN is refused."""
    arrays = _select(signals, names)
    shape_hint = "give arrays (N, T), or (T,) for one trace"
    for name, array in arrays.items():
        if array.ndim == 0:
            raise FormulaError(f"signal {name!r} is a single number, not samples over time", shape_hint)
    single = any(array.ndim == 1 for array in arrays.values())
    shapes = {array.shape if single else array.shape[:2] for array in arrays.values()}
    if len(shapes) > 1:
        sizes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise FormulaError(f"signals of different shapes: {sizes}", shape_hint)
    for name, array in arrays.items():
        missing = np.isnan(array)
        if missing.any():
            place = tuple(int(i) for i in np.argwhere(missing)[0])
            raise FormulaError(f"signal {name!r} is NaN at index {place}", "infinity is a value, NaN is not")
    samples = {name: (array[None] if single else array).swapaxes(0, 1) for name, array in arrays.items()}
    steps, rows = next(iter(samples.values())).shape[:2]
    if steps == 0:
        raise FormulaError("the signals have no samples", "a trace has at least one sample")
    return Trace(samples, steps, rows, single)


def read_sample(signals: Mapping[str, object], names: Sequence[str], rows: int) -> dict[str, Array]:
    """Check the signals ``names`` at one sample, (N, ...) each; others and NaN are let through."""
    if type(signals) is dict and names and _are_plain(signals, names, rows):
        return signals
    arrays = _select(signals, names) if names else {}
    for name, array in arrays.items():
        if array.ndim == 0 or len(array) != rows:
            raise FormulaError(f"signal {name!r} has shape {array.shape}, expected ({rows},) or ({rows}, V)")
    return arrays


def _are_plain(signals: dict[str, object], names: Sequence[str], rows: int) -> bool:
    # The most frequent case, in which there is nothing to convert.
    for name in names:
        x = signals.get(name)
        if type(x) is not np.ndarray or x.dtype is not _FLOAT or not x.ndim or len(x) != rows:
            return False
    return True


def _select(signals: Mapping[str, object], names: Sequence[str]) -> dict[str, Array]:
    if not isinstance(signals, Mapping):
        raise FormulaError(f"signals must be a mapping from names to arrays, not {type(signals).__name__}")
    if not names and not signals:
        raise FormulaError("no signals are given", "give any signal: it sets the number of samples")
    arrays = {}
    for name in names or list(signals)[:1]:
        if name not in signals:
            raise FormulaError(f"signal {name!r} is missing", did_you_mean(name, map(str, signals)))
        values = signals[name]
        if not isinstance(values, np.ndarray):
            raise FormulaError(f"signal {name!r} must be a NumPy array, not {type(values).__name__}")
        if values.dtype.kind not in "biuf":
            raise FormulaError(f"signal {name!r} holds {values.dtype} values, not real numbers")
        arrays[name] = values.astype(np.float64, copy=False)
    return arrays
