"""Corner tables: values that depend on samples not seen yet.

The value of a formula as a function of its unbounded future operators' values at the next sample, x_1..x_n,
is composed of minimum and maximum. It is monotone in every x_i, and

    f(x) = max(f(x with x_i = -inf), min(f(x with x_i = inf), x_i)),

so its values at the 2^n corners determine it. A table has n leading axes, the i-th of length 2 (first minus
infinity, then infinity) if the value depends on x_i, else of length 1: tables broadcast against each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from avrare.logic.semantics.window_operators import Array

MAX_CORNERS = 4
"""Unbounded future operators n in a table, at most: a step costs up to 4^n operations per particle."""


def corner(i: int, n: int) -> Array:
    """Return the table of x_i itself: n corner axes and one for the particles."""
    shape = [1] * (n + 1)
    shape[i] = 2
    return np.array([-math.inf, math.inf]).reshape(shape)


def evaluate(table: Array, values: Sequence[Array | None], lead: int, trailing: int) -> Array:
    """Evaluate a table's function at ``values``.

    Args:
        table: (corners, ...), the ``trailing`` last axes belonging to vehicles.
        values: An array for each corner axis, which broadcasts from the right against the table without its
            corner axes; None if the table does not depend on it.
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
    """Convert tables over the x of this sample to tables over the x of the next one.

    Args:
        tables: (rows..., corners, N, ...).
        values: Old x_i as tables over the new ones, (corners, N, ...) each.
        rows: Number of axes before the corners, 0 or 1.
    """
    n = len(values)
    if rows:
        tables = np.moveaxis(tables, 0, n)
    before = tables.shape[: n + rows]
    trailing = tables.ndim - n - rows - 1
    spread = tables.reshape(*before, *(1,) * n, *tables.shape[n + rows :])
    return evaluate(spread, values, n + 1, trailing)


def stack(tables: Sequence[Array]) -> Array:
    """Stack tables, which may differ in axes that broadcast."""
    if len({table.shape for table in tables}) > 1:
        return np.stack(np.broadcast_arrays(*tables))
    return np.array(tables)
