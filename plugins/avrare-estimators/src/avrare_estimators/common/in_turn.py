"""Choice among the rows of several runs, all runs alike."""

from __future__ import annotations

import numpy as np

from avrare.rollout.request import Integers


def take_in_turn(run: Integers, most: int) -> Integers:
    """Return the indices of at most ``most`` entries with runs (F,): the first of each, then the second.

    Entries that are left out of a part are left out of the whole as well.
    """
    order = np.argsort(run, kind="stable")
    _, begin, inverse = np.unique(run[order], return_index=True, return_inverse=True)
    rank = np.empty(len(run), dtype=np.int64)
    rank[order] = np.arange(len(run)) - begin[inverse]
    return np.sort(np.lexsort((run, rank))[:most])


def far_apart(count: int) -> Integers:
    """Return 0..count - 1 in an order whose beginnings are spread evenly (van der Corput's sequence)."""
    index, place, digit = np.arange(count), np.zeros(count), 0.5
    while index.any():
        place += digit * (index % 2)
        index, digit = index // 2, digit / 2.0
    return np.argsort(np.argsort(place, kind="stable"), kind="stable")
