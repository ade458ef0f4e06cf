"""Rollouts driven from their noise, with all that was on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare import batch
from avrare.protocols import Floats, Signals
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers, Rollouts

_ROW_STEPS = 4000
"""States that are held at once, of all rollouts and steps; a single long rollout may have more."""


@dataclass(frozen=True)
class Drive:
    """A rollout.

    Attributes:
        signals: name -> (T, ...): T is steps + 1, or less where it broke down.
        states: T states of the system, one particle each.
        robustness: Of the first specification; of the samples before the error where it broke down.
        violated: The first specification is violated.
        error: Why it broke down, or None.
    """

    signals: dict[str, NDArray[Any]]
    states: tuple[Any, ...]
    robustness: float
    violated: bool
    error: str | None

    @property
    def outcome(self) -> str:
        """``fails``, ``passes`` or ``error``."""
        if self.error is not None:
            return "error"
        return "fails" if self.violated else "passes"


def drive(problem: Problem, tape: Floats) -> Drive:
    """Drive one noise tape (steps + 1, noise_size).

    Raises:
        UsageError: The tape has another shape.
    """
    return drives(problem, tape[None])[0]


def drives(problem: Problem, tapes: Floats) -> list[Drive]:
    """Drive noise tapes (N, steps + 1, noise_size) side by side.

    Raises:
        UsageError: The tapes have another shape.
    """
    rows = max(_ROW_STEPS // (problem.steps + 1), 1)
    parts = [_together(problem, tapes[begin : begin + rows]) for begin in range(0, len(tapes), rows)]
    return [found for part in parts for found in part]


def _together(problem: Problem, tapes: Floats) -> list[Drive]:
    outcome = problem.replay(tapes, keep_carries=True)
    carried = [(rows, carry.system) for _, rows, carry in outcome.carries]
    samples = [(rows, problem.system.signals(state), state) for rows, state in carried]
    return [_one(outcome, samples, row) for row in range(len(tapes))]


def _one(outcome: Rollouts, samples: list[tuple[Integers, Signals, Any]], row: int) -> Drive:
    found = [
        (int(np.searchsorted(rows, row)), signals, state) for rows, signals, state in samples if row in rows
    ]
    names = found[0][1] if found else ()
    signals = {name: np.stack([sample[name][k] for k, sample, _ in found]) for name in names}
    states = tuple(batch.take(state, np.array([k])) for k, _, state in found)
    error = "; ".join(outcome.messages) or "no reason given" if outcome.error[row] else None
    return Drive(signals, states, float(outcome.robustness[row, 0]), bool(outcome.violated[row, 0]), error)
