"""The score for formulas that may still come true: their danger at every step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.logic import formula as f
from avrare.logic.api import Formula
from avrare.logic.online import FormulaMonitor
from avrare.protocols import Floats, Signals, Verdict
from avrare.rollout.danger import Danger, positive

_NEARLY = math.nextafter(1.0, 0.0)


@dataclass(frozen=True)
class Shape:
    """A formula as the score sees it.

    Attributes:
        body: In positive form; of ``always φ`` over the whole run, φ.
        atoms: Its past-only parts.
        repeated: Whether the body must hold at every sample rather than at the first.
        window: Samples that it has to see at once.
    """

    body: f.Node
    atoms: tuple[f.Node, ...]
    repeated: bool
    window: float


def shape_of(formula: Formula) -> Shape | None:
    """How to score the formula by its progress.

    None where robustness or margin will do (``always`` of what looks only back: nothing is ever pending), and
    where negations cannot be pushed down to past-only parts: quantifiers, iff, xor or a negated until over
    the future.
    """
    found: list[f.Node] = []
    body = positive(formula.node, found)
    match body:
        case None:
            return None
        case f.Window("always", 0, math.inf, child):
            pending = f.horizon(child)
            return Shape(child, tuple(found), True, pending + 1) if pending else None
        case _:
            return Shape(body, tuple(found), False, math.inf) if f.horizon(body) else None


@dataclass(frozen=True)
class ProgressState:
    """State of a progress score.

    Attributes:
        inner: State of the formula's monitor.
        atoms: States of the atoms' monitors.
        values: Per atom, (N, W) margins at the newest samples.
        settled: (N,) danger of the positions that have left the window.
        score: (N,) running maximum.
        t: Samples seen.
    """

    inner: Any
    atoms: tuple[Any, ...]
    values: tuple[Floats, ...] | None
    settled: Floats
    score: Floats
    t: int


class ProgressScored:
    """Scores a formula by its danger; 1 exactly where a whole run violates it.

    Args:
        inner: Monitor of the formula.
        shape: Of the formula.
        steps: Steps of a run.
        nominal: Signals of the noise-free run, which give the atoms' typical sizes; None: 1.
    """

    def __init__(
        self, inner: FormulaMonitor, shape: Shape, steps: int, nominal: Sequence[Signals] | None = None
    ) -> None:
        self.inner, self.shape, self.steps = inner, shape, steps
        formula = inner.formula
        always = [f.Window("always", 0, math.inf, atom) for atom in shape.atoms]
        self._atoms = [FormulaMonitor(replace(formula, node=node)) for node in always]
        self._scales = [1.0] * len(self._atoms)
        if nominal:
            self._scales = [_typical(monitor, nominal) for monitor in self._atoms]

    def start(self, n: int) -> ProgressState:
        """Before sample 0."""
        atoms = tuple(monitor.start(n) for monitor in self._atoms)
        return ProgressState(self.inner.start(n), atoms, None, np.zeros(n), np.full(n, -np.inf), 0)

    def update(self, state: ProgressState, signals: Signals) -> tuple[ProgressState, Verdict]:
        """After one more sample."""
        inner, verdict = self.inner.update(state.inner, signals)
        pairs = [m.update(s, signals)[0] for m, s in zip(self._atoms, state.atoms, strict=True)]
        newest = [_margin(m, s)[:, None] for m, s in zip(self._atoms, pairs, strict=True)]
        keep = int(min(self.shape.window, self.steps + 1))
        values = tuple(
            np.concatenate([past, new], axis=1)[:, -keep:]
            for past, new in zip(state.values or [x[:, :0] for x in newest], newest, strict=True)
        )
        danger, settled = self._danger(values, state)
        danger = np.minimum(np.nan_to_num(danger, nan=0.0), _NEARLY)
        if state.t >= self.steps:
            danger = np.where(verdict.violated, 1.0, danger)
        score = np.maximum(state.score, danger)
        new = ProgressState(inner, tuple(pairs), values, settled, score, state.t + 1)
        return new, replace(verdict, score=score)

    def _danger(self, values: tuple[Floats, ...], state: ProgressState) -> tuple[Floats, Floats]:
        """(N,) of the samples so far, and of the positions that will not be looked at again."""
        width = values[0].shape[1]
        along = [np.ascontiguousarray(x.T) for x in values]
        with np.errstate(all="ignore"):
            danger_of = Danger(along, state.t + 1 - width, self.steps, self._scales)
            if not self.shape.repeated:
                return danger_of.at_first(self.shape.body), state.settled
            each = danger_of(self.shape.body)
        danger = np.maximum(state.settled, each.max(axis=0))
        settled = np.maximum(state.settled, each[0]) if width >= self.shape.window else state.settled
        return danger, settled


def _margin(monitor: FormulaMonitor, state: Any) -> Floats:
    margin = monitor.margin(state)
    assert margin is not None  # the monitor's formula is `always` of what looks only back
    return margin


def _typical(monitor: FormulaMonitor, nominal: Sequence[Signals]) -> float:
    """Mean size of an atom's margin along the noise-free run, 1 where there is none."""
    state, sizes = monitor.start(1), []
    for signals in nominal:
        state, _ = monitor.update(state, signals)
        sizes.append(abs(float(_margin(monitor, state)[0])))
    finite = [size for size in sizes if math.isfinite(size)]
    mean = sum(finite) / len(finite) if finite else 0.0
    return mean or 1.0
