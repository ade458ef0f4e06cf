"""How to follow a formula's value at sample 0 from one prefix to the next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic import formula as f
from avrare.logic.leaves import Fold, Leaf, Recompute, Wait
from avrare.logic.memory import Memory, remember
from avrare.logic.robustness import Evaluator, align

Array = NDArray[Any]


@dataclass(frozen=True)
class Plan:
    """A formula cut into leaves.

    Attributes:
        skeleton: Connectives and quantifiers over ``Slot(k)``, the value of leaf k.
        leaves: The parts that change with time.
        memories: Unbounded past operators below the leaves, as ``Slot(k)`` of the leaves' formulas.
        window: Samples to keep; ``math.inf``: all.
        horizon: The last sample that matters.
        is_invariant: The formula is ``always φ`` where φ looks only back; its leaf is the only one.
    """

    skeleton: f.Node
    leaves: tuple[Leaf, ...]
    memories: tuple[Memory, ...]
    window: float
    horizon: float
    is_invariant: bool


def make_plan(node: f.Node, memories: bool) -> Plan:
    """The plan of a formula.

    Args:
        node: The formula.
        memories: Whether unbounded past operators are carried along rather than evaluated on all samples.
    """
    builder = _Builder(memories)
    skeleton = builder.cut(hoist(node))
    kept = tuple(builder.memories)
    windows = [leaf.window for leaf in builder.leaves] + [memory.window for memory in kept]
    invariant = isinstance(skeleton, f.Slot) and _is_invariant(builder.leaves[0])
    return Plan(skeleton, tuple(builder.leaves), kept, max(windows), f.horizon(node), invariant)


def hoist(node: f.Node) -> f.Node:
    """The formula with ``forall (always φ)`` at its root turned into ``always (forall φ)``, its equal."""
    if not isinstance(node, f.Forall):
        return node
    child = hoist(node.child)
    if isinstance(child, f.Window) and child.op == "always":
        return f.rebuild(child, f.Forall)
    return f.Forall(child)


def _is_invariant(leaf: Leaf) -> bool:
    return isinstance(leaf, Fold) and (leaf.op, leaf.lo, leaf.hi, leaf.ahead) == ("always", 0, math.inf, 0)


class _Builder:
    def __init__(self, memories: bool) -> None:
        self.leaves: list[Leaf] = []
        self.memories: list[Memory] = []
        self.use_memories = memories

    def cut(self, node: f.Node) -> f.Node:
        """The skeleton of ``node``; its leaves are collected."""
        match node:
            case f.Not() | f.Connective() | f.Forall() | f.Exists() if f.horizon(node) > 0:
                return f.rebuild(node, self.cut)
            case f.Until(op="unless"):
                return self.cut(f.expand_unless(node))
        self.leaves.append(self._leaf(node))
        return f.Slot(len(self.leaves) - 1)

    def _leaf(self, node: f.Node) -> Leaf:
        match node:
            case f.Window("always" | "eventually" as op, lo, hi, child) if math.isfinite(f.horizon(child)):
                child, ahead = self._carry(child), int(f.horizon(child))
                return Fold(op, lo, hi, child, ahead, ahead + f.history(child) + 1)
            case f.Until("until", lo, hi, left, right) if f.horizon(left) == f.horizon(right) == 0:
                left, right = self._carry(left), self._carry(right)
                return Wait(lo, hi, left, right, max(f.history(left), f.history(right)) + 1)
            case _:
                return Recompute(node, f.horizon(node))

    def _carry(self, node: f.Node) -> f.Node:
        return remember(node, self.memories) if self.use_memories else node


def prefix_values(plan: Plan, evaluate: Evaluator) -> Array:
    """The value at sample 0 of every prefix: (T, N).

    Args:
        plan: Made without memories.
        evaluate: Evaluator of the whole traces.
    """
    values = [_series(leaf, evaluate) for leaf in plan.leaves]
    return combine(plan, evaluate, values)


def combine(plan: Plan, evaluate: Evaluator, values: Sequence[Array]) -> Array:
    """The formula's value from its leaves' values, (T, N, ...) each."""
    root = Evaluator({}, len(values[0]), evaluate.rows, evaluate.algebra, evaluate.closed, values)
    return root(plan.skeleton)


def _series(leaf: Leaf, evaluate: Evaluator) -> Array:
    if isinstance(leaf, Fold) and leaf.ahead == 0:
        return _running(leaf.lo, leaf.hi, *evaluate.reduction(leaf.op), evaluate(leaf.child))
    if isinstance(leaf, Wait):
        left, right = np.broadcast_arrays(*align(evaluate(leaf.left), evaluate(leaf.right)))
        held = np.minimum.accumulate(left, axis=0)
        if not evaluate.closed:
            held = np.concatenate([np.full_like(held[:1], evaluate.algebra.top), held[:-1]])
        return _running(leaf.lo, leaf.hi, np.maximum, evaluate.algebra.bottom, np.minimum(right, held))
    carried, values = None, []
    for t in range(int(min(leaf.horizon + 1, evaluate.steps))):
        carried, value = leaf.step(evaluate.last(t + 1, leaf.window), t, carried)
        values.append(value)
    values += values[-1:] * (evaluate.steps - len(values))
    return np.stack(values)


def _running(lo: int, hi: float, join: np.ufunc, empty: Any, x: Array) -> Array:
    """``y[t]`` = join over ``x[lo .. min(hi, t)]``."""
    y = np.full_like(x, empty)
    end = int(min(hi + 1, len(x)))
    if lo < end:
        y[lo:end] = join.accumulate(x[lo:end], axis=0)
        y[end:] = y[end - 1]
    return y
