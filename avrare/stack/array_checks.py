"""Checks of the arrays that the parts of a stack return: one entry for each particle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.protocols import Bools, Floats, Signals


def check_signals(signals: Signals, n: int) -> Signals:
    """Return signals by name, each an array (n, ...).

    Raises:
        UsageError: They are not a mapping, or one has another shape.
    """
    if not isinstance(signals, Mapping):
        raise UsageError(
            f"signals(state) returned {type(signals).__name__}, not a mapping from names to arrays",
            'return a dict such as {"x": state.x}',
        )
    return {name: check_rows(f"signal {name!r}", values, n) for name, values in signals.items()}


def check_rows(what: str, values: object, n: int) -> NDArray[Any]:
    """Return ``values``, an array (n, ...); a ``UsageError`` names ``what`` has another shape."""
    if not isinstance(values, np.ndarray) or values.ndim == 0 or values.shape[0] != n:
        shape = values.shape if isinstance(values, np.ndarray | np.generic) else type(values).__name__
        raise UsageError(
            f"{what} has shape {shape}, but a batch of {n} particles needs ({n},) or ({n}, ...)",
            "return NumPy arrays with one entry a particle",
        )
    return values


def find_nan(values: Floats) -> Bools:
    """Return the rows (N,) with a number that is NaN."""
    if values.dtype.kind != "f":
        return np.zeros(len(values), dtype=bool)
    return np.asarray(np.isnan(values).reshape(len(values), -1).any(axis=1))
