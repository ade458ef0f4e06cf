"""Arithmetic on lanes: several searches in lockstep, one in each lane of a vector register.

These are the functions that kernels call, in NumPy; ``vectors`` gives the compiler their instructions. Both
do the same IEEE operations in the same order, so that their results have the same bits, and no lane ever
depends on another one. A memory is an array (rows, WIDTH); compiled code gets its address.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

WIDTH = 8
"""Number of lanes: one AVX-512 register, or two of AVX2."""
Lanes = Any
"""Numbers of all lanes: an array (WIDTH,), in compiled code a vector register."""
Mask = Any
"""Truth values of all lanes."""
Memory = Any
"""Rows of lanes or, where a kernel reads single numbers, a plain array: an address in compiled code."""


def load(memory: Memory, row: int) -> Lanes:
    """Return a row."""
    return memory[row].copy()


def store(memory: Memory, row: int, value: Lanes) -> None:
    """Set a row."""
    memory[row] = value


def peek(memory: Memory, index: int) -> float:
    """Return one number, by its place in the flat memory."""
    value: float = memory.reshape(-1)[index]
    return value


def poke(memory: Memory, index: int, value: float) -> None:
    """Set one number, by its place in the flat memory."""
    memory.reshape(-1)[index] = value


def splat(value: float) -> Lanes:
    """Return ``value`` in every lane."""
    return np.full(WIDTH, value)


def select(mask: Mask, yes: Lanes, no: Lanes) -> Lanes:
    """Return ``yes`` where the mask is true, else ``no``."""
    return np.where(mask, yes, no)


def any_of(mask: Mask) -> bool:
    """Return whether a lane is true."""
    return bool(np.any(mask))


def root(value: Lanes) -> Lanes:
    """Return the square root."""
    return np.sqrt(value)


def magnitude(value: Lanes) -> Lanes:
    """Return the absolute value."""
    return np.abs(value)


def nearest(value: Lanes) -> Lanes:
    """Round to the nearest integer, ties to even."""
    return np.rint(value)


def below(value: Lanes) -> Lanes:
    """Round down to an integer."""
    return np.floor(value)


def times_power_of_two(value: Lanes, power: Lanes) -> Lanes:
    """Return value x 2^power for a whole power; result and value must be normal numbers."""
    bits = np.asarray(value).view(np.int64) + (np.asarray(power).astype(np.int64) << 52)
    return bits.view(np.float64)


def exponent(value: Lanes) -> Lanes:
    """Return the whole power of two of a normal number."""
    bits: NDArray[np.int64] = np.asarray(value).view(np.int64)
    return (((bits >> 52) & 0x7FF) - 1023).astype(np.float64)


def mantissa(value: Lanes) -> Lanes:
    """Return |value| over that power of two, in [1, 2)."""
    bits: NDArray[np.int64] = np.asarray(value).view(np.int64)
    return ((bits & ((1 << 52) - 1)) | (1023 << 52)).view(np.float64)
