"""Values that depend on samples not seen yet, kept as tables over a few corners.

The value of a formula as a function of its unbounded future operators' values at the next sample, x_1..x_n,
is built from minimum and maximum alone. It grows with every x_i, and

    f(x) = max(f(x with x_i = -inf), min(f(x with x_i = inf), x_i)),

so the 2^n values at the corners determine it. A table has n leading axes, the i-th of length 2 (first minus
infinity, then infinity) where the value depends on x_i, else of length 1: tables broadcast against each
other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

MAX_CORNERS = 4
"""Most unbounded future operators n in one table: each step costs up to 4^n operations per particle."""


def corner(i: int, n: int) -> Array:
    """The table of x_i itself: n corner axes and one for the particles."""
    shape = [1] * (n + 1)
    shape[i] = 2
    return np.array([-math.inf, math.inf]).reshape(shape)


def evaluate(table: Array, values: Sequence[Array | None], lead: int, trailing: int) -> Array:
    """The table's function at ``values``.

    Args:
        table: (corners, ...), the ``trailing`` last axes belonging to vehicles.
        values: Per corner axis, an array that broadcasts from the right against the table without its corner
            axes, or None where the table does not depend on it.
        lead: Axes of ``values`` before those of vehicles.
        trailing: Axes of the table that belong to vehicles.
    """
    for value in values:
        low = table[0]
        if len(table) == 1:
            table = low
            continue
        assert value is not None
        missing = lead + trailing - value.ndim
        value = value.reshape(value.shape + (1,) * missing) if missing else value
        table = np.maximum(low, np.minimum(table[1], value))
    return table


def compose(tables: Array, values: Sequence[Array | None], rows: int) -> Array:
    """Tables over the x of this sample as tables over the x of the next one.

    Args:
        tables: (rows..., corners, N, ...).
        values: The old x_i as tables over the new ones, (corners, N, ...) each.
        rows: Axes before the corners, 0 or 1.
    """
    n = len(values)
    if rows:
        tables = np.moveaxis(tables, 0, n)
    before = tables.shape[: n + rows]
    trailing = tables.ndim - n - rows - 1
    spread = tables.reshape(*before, *(1,) * n, *tables.shape[n + rows :])
    return evaluate(spread, values, n + 1, trailing)


def stack(tables: Sequence[Array]) -> Array:
    """Tables one after the other, which may differ in axes that broadcast."""
    if len({table.shape for table in tables}) > 1:
        return np.stack(np.broadcast_arrays(*tables))
    return np.array(tables)
