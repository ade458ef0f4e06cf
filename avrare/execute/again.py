"""Whether an outcome that was stored comes out again: else a resumed estimate would mix two systems."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.errors import UsageError
from avrare.execute.work import Work
from avrare.rollout.request import Request, Rollouts

_FIELDS = ("scores", "robustness", "violated", "error", "log_weight")
"""The course of the scores first: it tells the step."""


def check_again(work: Work, chunk: Request, stored: Rollouts) -> None:
    """Run the stored chunk's least robust rollout again, which must start from the beginning.

    Where it differs the whole chunk is run, as the rows of a system may depend on their neighbours.

    Raises:
        UsageError: The system gives another answer now.
    """
    row = int(np.argmin(np.where(stored.error, np.inf, stored.robustness.min(axis=1))))
    again = work.run(chunk.slice(row, row + 1))
    if not _difference(stored, row, again, 0):
        return
    again = work.run(chunk)
    difference = _difference(stored, row, again, row)
    if difference:
        raise UsageError(
            f"a saved rollout (run {chunk.run[row]}, stage {chunk.stage[row]}, particle "
            f"{chunk.particle[row]}) does not come out as it did: {difference}",
            "the code or its libraries have changed since: go back to them, or start anew in another folder",
        )


def _difference(stored: Rollouts, row: int, again: Rollouts, other: int) -> str:
    """What is not the same, empty where all is."""
    for name in _FIELDS:
        one, two = getattr(stored, name)[row], getattr(again, name)[other]
        if not _same(one, two).all():
            return _described(name, one, two)
    for name in sorted({*stored.counts, *again.counts}):
        one, two = _count(stored, name, row), _count(again, name, other)
        if one != two:
            return f"{name} {one} -> {two}"
    return ""


def _same(one: Any, two: Any) -> Any:
    if np.shape(one) != np.shape(two):
        return np.zeros(1, dtype=bool)
    return (one == two) | ((one != one) & (two != two))  # NaN is NaN


def _count(outcome: Rollouts, name: str, row: int) -> int:
    return int(outcome.counts[name][row]) if name in outcome.counts else 0


def _described(name: str, one: Any, two: Any) -> str:
    if name == "scores" and one.shape == two.shape:
        step = int(np.flatnonzero(~_same(one, two))[0])
        return f"from step {step} on, score {one[step]:.17g} -> {two[step]:.17g}"
    return f"{name} {np.ravel(one).tolist()} -> {np.ravel(two).tolist()}"
