"""Batched evaluation whose rows have the same bits in any batch and place.

BLAS sums a partial tile in another order than a full one. So every product has the same number of rows, and
its columns are padded to whole tiles of all common BLAS kernels. There are few rows: the kernel for AVX2 of
OpenBLAS takes twelve at a time and sums the first six in another order than the others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Real = TypeVar("Real", np.float32, np.float64)

BLOCK = 8
"""Rows of every product."""


def evaluate_in_blocks(
    function: Callable[[NDArray[Real]], NDArray[Real]], rows: NDArray[Real], outputs: int, together: int
) -> NDArray[np.float64]:
    """Evaluate ``function`` on blocks of rows, the last block padded with zeros.

    Args:
        function: Maps blocks (b, BLOCK, D) to (b, BLOCK, outputs).
        rows: (n, D) inputs; their precision is that of the blocks.
        outputs: Number of outputs per row.
        together: Blocks per call; few enough that the intermediate arrays stay in the cache.

    Returns:
        (n, outputs) in double precision.
    """
    count, inputs = rows.shape
    blocks: NDArray[Real] = np.zeros((-(-count // BLOCK), BLOCK, inputs), rows.dtype)
    blocks.reshape(-1, inputs)[:count] = rows
    out = np.empty((*blocks.shape[:2], outputs))
    for i in range(0, len(blocks), together):
        out[i : i + together] = function(blocks[i : i + together])
    return out.reshape(-1, outputs)[:count]


def pad_columns(array: NDArray[Real], tile: int) -> NDArray[Real]:
    """Append columns of zeros up to a whole number of tiles."""
    return np.pad(array, ((0, 0), (0, -array.shape[1] % tile)))
