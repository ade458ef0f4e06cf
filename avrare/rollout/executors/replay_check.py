"""Check that a stored rollout reproduces: otherwise a resumed estimate would mix two systems."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.rollout.executors.work import Work
from avrare.rollout.request import Request, Rollouts

_FIELDS = ("scores", "robustness", "violated", "error", "log_weight")
"""Fields to compare, scores first: they give the step."""


def check_reproduces(work: Work, chunk: Request, stored: Rollouts) -> None:
    """Run the least robust rollout of a stored chunk again and compare.

    Where it differs, the complete chunk is run, as rows of a system may depend on their neighbours.

    Args:
        work: Work of the chunk.
        chunk: Request whose rows start from the beginning.
        stored: Outcome that was stored.

    Raises:
        UsageError: The rollout comes out differently.
    """
    row = int(np.argmin(np.where(stored.error, np.inf, stored.robustness.min(axis=1))))
    repeated = work.run(chunk.slice(row, row + 1))
    if not _difference(stored, row, repeated, 0):
        return
    repeated = work.run(chunk)
    difference = _difference(stored, row, repeated, row)
    if difference:
        raise UsageError(
            f"a saved rollout (run {chunk.run[row]}, stage {chunk.stage[row]}, particle "
            f"{chunk.particle[row]}) does not reproduce: {difference}",
            "the code or its libraries have changed since: restore them, or start again in another folder",
        )


def _difference(stored: Rollouts, row: int, repeated: Rollouts, other: int) -> str:
    for name in _FIELDS:
        one, two = getattr(stored, name)[row], getattr(repeated, name)[other]
        if not _same(one, two).all():
            return _describe(name, one, two)
    for name in sorted({*stored.counts, *repeated.counts}):
        one, two = _count(stored, name, row), _count(repeated, name, other)
        if one != two:
            return f"{name} {one} -> {two}"
    return ""


def _same(one: Any, two: Any) -> Any:
    if np.shape(one) != np.shape(two):
        return np.zeros(1, dtype=bool)
    return (one == two) | ((one != one) & (two != two))  # NaN is NaN


def _count(outcome: Rollouts, name: str, row: int) -> int:
    return int(outcome.counts[name][row]) if name in outcome.counts else 0


def _describe(name: str, one: Any, two: Any) -> str:
    if name == "scores" and one.shape == two.shape:
        step = int(np.flatnonzero(~_same(one, two))[0])
        return f"from step {step} on, score {one[step]:.17g} -> {two[step]:.17g}"
    return f"{name} {np.ravel(one).tolist()} -> {np.ravel(two).tolist()}"
