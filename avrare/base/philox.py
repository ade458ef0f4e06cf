"""Philox-4x32-10: random bits as a function of a counter and a key (Salmon et al., SC 2011)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Words = NDArray[np.uint64]

_MULTIPLIER_0, _MULTIPLIER_1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL_0, _WEYL_1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _SHIFT = np.uint64(0xFFFFFFFF), np.uint64(32)


def philox(counter: tuple[Words, Words, Words, Words], key: tuple[Words, Words]) -> tuple[Words, ...]:
    """Return four 32-bit words (in uint64 arrays) for each counter, after ten rounds."""
    c0, c1, c2, c3 = (np.array(word) for word in np.broadcast_arrays(*counter))
    k0, k1 = key
    product_0, product_1 = np.empty_like(c0), np.empty_like(c0)
    for _ in range(10):  # in place: allocation would dominate
        np.multiply(c0, _MULTIPLIER_0, out=product_0)
        np.multiply(c2, _MULTIPLIER_1, out=product_1)
        np.right_shift(product_1, _SHIFT, out=c0)
        c0 ^= c1
        c0 ^= k0
        np.right_shift(product_0, _SHIFT, out=c2)
        c2 ^= c3
        c2 ^= k1
        np.bitwise_and(product_1, _LOW, out=c1)
        np.bitwise_and(product_0, _LOW, out=c3)
        k0, k1 = (k0 + _WEYL_0) & _LOW, (k1 + _WEYL_1) & _LOW
    return c0, c1, c2, c3


def to_uniform(high: Words, low: Words) -> Floats:
    """Return numbers in the open interval (0, 1) from 53 of the 64 bits of two words."""
    bits = ((high << _SHIFT) | low) >> np.uint64(11)
    return np.ascontiguousarray((bits.astype(np.float64) + 0.5) * 2.0**-53)
