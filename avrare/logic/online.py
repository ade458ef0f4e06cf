"""The online monitor: the robustness of every prefix, one sample at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import FormulaError
from avrare.logic.algebra import Robustness, Truth
from avrare.logic.plan import combine, make_plan
from avrare.logic.robustness import Evaluator
from avrare.logic.samples import read_sample
from avrare.protocols import Bools, Floats, Signals, Verdict

if TYPE_CHECKING:
    from avrare.logic.api import Formula

Array = NDArray[Any]
_ALGEBRAS = (Robustness(), Truth())


@dataclass(frozen=True)
class Carried:
    """What one algebra carries from sample to sample.

    Attributes:
        leaves: Per leaf, arrays (N, ...); None before the first sample.
        memories: Per memory, its newest values (N, W, ...); None before the first sample.
    """

    leaves: tuple[Any, ...]
    memories: tuple[Array | None, ...]


@dataclass(frozen=True)
class MonitorState:
    """A monitor's state: a value that is copied with its particle.

    Attributes:
        t: Samples seen; the same for all particles of a batch.
        window: The newest samples that are still needed, (N, W, ...) each.
        robust: Carried by the robustness.
        truth: Carried by the Boolean evaluation.
        robustness: (N,) of the samples so far.
        violated: (N,) of the samples so far.
        score: (N,) running maximum of minus the robustness.
        newest: (N,) for ``always φ``: the robustness of φ at the newest sample; else None.
    """

    t: int
    window: dict[str, Array] | None
    robust: Carried
    truth: Carried
    robustness: Floats
    violated: Bools
    score: Floats
    newest: Floats | None


class FormulaMonitor:
    """Follows a formula at sample 0 (an ``avrare.protocols.Specification``).

    A step costs the same at every sample when the formula is built from ``always`` and ``eventually`` over
    parts with bounded horizon, such as ``always φ`` with φ looking only back; otherwise the whole history is
    kept and evaluated. NaN makes a row's robustness NaN for good where the formula depends on it; such a row
    is neither violated nor does its score change.

    Args:
        formula: From ``avrare.stl``.
    """

    def __init__(self, formula: Formula) -> None:
        self.formula = formula
        self._plan = make_plan(formula.node, memories=True)
        self._names = formula.signals

    def start(self, n: int) -> MonitorState:
        """Monitor state of ``n`` particles before sample 0."""
        nothing = Carried((None,) * len(self._plan.leaves), (None,) * len(self._plan.memories))
        newest = np.full(n, math.inf) if self._plan.is_invariant else None
        robustness, violated = np.full(n, math.inf), np.zeros(n, dtype=np.bool_)
        return MonitorState(0, None, nothing, nothing, robustness, violated, np.full(n, -math.inf), newest)

    def margin(self, state: MonitorState) -> Floats | None:
        """For ``always φ``, φ looking only back: the robustness (N,) of φ at the newest sample; else None.

        It is infinite before sample 0. Unlike the running minimum it tells apart particles that have been
        equally near to failure.
        """
        return state.newest

    def update(self, state: MonitorState, signals: Signals) -> tuple[MonitorState, Verdict]:
        """Monitor state and verdict after one more sample.

        Args:
            state: Not changed.
            signals: name -> (N,), or (N, V) below a quantifier.

        Raises:
            FormulaError: A signal is missing or has the wrong shape.
        """
        sample = read_sample(signals, self._names, len(state.score))
        new = self._frozen(state) if state.t > self._plan.horizon else self._advance(state, sample)
        return new, Verdict(new.robustness, new.violated, new.score)

    def _frozen(self, state: MonitorState) -> MonitorState:
        return replace(state, t=state.t + 1, window=None)

    def _advance(self, state: MonitorState, sample: Mapping[str, Array]) -> MonitorState:
        past = state.window or {}
        window = {name: _append(past.get(name), x) for name, x in sample.items()}
        robust, robustness = self._values(_ALGEBRAS[0], state, state.robust, window)
        truth, satisfied = self._values(_ALGEBRAS[1], state, state.truth, window)
        keep = self._plan.window - 1
        return MonitorState(
            t=state.t + 1,
            window={name: _newest(x, keep) for name, x in window.items()} if keep > 0 else None,
            robust=robust,
            truth=truth,
            robustness=robustness,
            violated=~satisfied & ~np.isnan(robustness),
            score=np.fmax(state.score, -robustness),
            newest=robust.leaves[0][1] if self._plan.is_invariant else None,
        )

    def _values(
        self, algebra: Robustness, state: MonitorState, before: Carried, window: Mapping[str, Array]
    ) -> tuple[Carried, Array]:
        samples = {name: np.moveaxis(x, 1, 0) for name, x in window.items()}
        steps = int(min(state.t + 1, self._plan.window))
        evaluate = Evaluator(samples, steps, len(state.score), algebra, self.formula.closed)
        memories, evaluate = self._remember(evaluate, before.memories)
        leaves, values = [], []
        for leaf, carried in zip(self._plan.leaves, before.leaves, strict=True):
            carried, value = leaf.step(evaluate, state.t, carried)
            leaves.append(carried)
            values.append(value[None])
        value = combine(self._plan, evaluate, values)[0]
        if value.ndim != 1:
            raise FormulaError(
                "the formula has trailing axes left at every sample",
                "put 'forall o in others:' before the part with array-valued signals",
            )
        return Carried(tuple(leaves), memories), value

    def _remember(
        self, evaluate: Evaluator, before: Sequence[Array | None]
    ) -> tuple[tuple[Array, ...], Evaluator]:
        """The memories after this sample, and the evaluator that knows them."""
        kept: list[Array] = []
        slots: list[Array] = []
        for memory, past in zip(self._plan.memories, before, strict=True):
            value = memory.step(replace(evaluate, slots=slots), None if past is None else past[:, -1])
            values = _append(past, value)
            slots.append(np.moveaxis(values, 1, 0)[-evaluate.steps :])
            kept.append(_newest(values, max(self._plan.window - 1, 1)))
        return tuple(kept), replace(evaluate, slots=slots)


def _append(past: Array | None, newest: Array) -> Array:
    """(N, W, ...) with one more sample; never a view of ``newest``."""
    newest = newest[:, None]
    return newest.copy() if past is None else np.concatenate([past, newest], axis=1)


def _newest(values: Array, count: float) -> Array:
    return values if values.shape[1] <= count else values[:, -int(count) :]
