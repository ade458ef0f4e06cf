"""How near a formula is to being violated, as a number in [0, 1] at every step: a score for any shape.

Robustness of a prefix is a poor guide where a formula may still come true: ``eventually (x > 1)`` starts as
violated as it will ever be. Danger counts what is left instead. It is 1 exactly where the formula is surely
violated, and below that

- a known part that holds with margin v has s / (s + v), where s is its typical size;
- ``eventually`` without a witness has (samples seen - 1 + deficit of the newest) / samples allowed: the time
  spent in vain, ties broken by how far away the newest sample is;
- ``and``, ``always`` and until take the largest danger of what they join, ``or`` the least.

Time that is not there counts as spent: a run that ends leaves nothing pending.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from avrare.logic import formula as f
from avrare.logic.windows import sliding
from avrare.protocols import Floats

_NEARLY = math.nextafter(1.0, 0.0)
Pair = tuple[f.Node, f.Node]
_OPPOSITE = {"always": "eventually", "eventually": "always", "next": "s_next", "s_next": "next"}


@dataclass(frozen=True)
class Atom(f.Node):
    """A maximal part that looks only back; its margin comes from a monitor of its own."""

    index: int


def positive(node: f.Node, found: list[f.Node], negated: bool = False) -> f.Node | None:
    """The formula with negations pushed down and its past-only parts as atoms; None if it has no such form.

    Args:
        node: The formula.
        found: The atoms so far, as formulas; extended.
        negated: Whether to negate it.
    """
    if f.horizon(node) == 0:
        found.append(f.Not(node) if negated else node)
        return Atom(len(found) - 1)
    match node:
        case f.Not(child):
            return positive(child, found, not negated)
        case f.Connective("and" | "or" | "implies" as op, left, right):
            flip = negated != (op == "implies")
            sides = positive(left, found, flip), positive(right, found, negated)
            op = "and" if (op == "and") != negated else "or"
            return f.Connective(op, *cast(Pair, sides)) if all(sides) else None
        case f.Window("always" | "eventually" as op, lo, hi, child):
            inner = positive(child, found, negated)
            return f.Window(_OPPOSITE[op] if negated else op, lo, hi, inner) if inner else None
        case f.Until("until", lo, hi, left, right) if not negated:
            sides = positive(left, found), positive(right, found)
            return f.Until("until", lo, hi, *cast(Pair, sides)) if all(sides) else None
        case f.Step("next" | "s_next" as op, child):
            inner = positive(child, found, negated)
            return f.Step(_OPPOSITE[op] if negated else op, inner) if inner else None
        case _:
            return None


@dataclass(frozen=True)
class Danger:
    """Danger of formulas in positive form, at every position of a window of samples.

    Attributes:
        values: Per atom, (W, N) margins at the samples of the window, oldest first.
        first: Index of the window's first sample in the trace.
        last: Index of the trace's last sample.
        scales: Per atom, its typical size.
    """

    values: Sequence[Floats]
    first: int
    last: int
    scales: Sequence[float]

    def __call__(self, node: f.Node) -> Floats:
        """(W, N), each position with what is known at the window's newest sample."""
        match node:
            case Atom(index):
                return self._atom(self.values[index], self.scales[index])
            case f.Connective("and", left, right):
                return np.maximum(self(left), self(right))
            case f.Connective(_, left, right):
                return np.minimum(self(left), self(right))
            case f.Window("always", lo, hi, child):
                return np.maximum(sliding(self(child), lo, hi, np.maximum), 0.0)
            case f.Window(_, lo, hi, child):
                return self._eventually(self(child), self._deficit(child), lo, hi)
            case f.Until():
                return self._until(node)
            case f.Step(op, child):
                return self._next(op, self(child))
        raise TypeError(f"not in positive form: {node!r}")

    def at_first(self, node: f.Node) -> Floats:
        """(N,) at the first position alone."""
        match node:
            case f.Connective(op, left, right):
                join = np.maximum if op == "and" else np.minimum
                return join(self.at_first(left), self.at_first(right))
            case f.Until(_, _, _, left, right):
                return self._until_at(node, self(left), self(right), 0)
            case _:
                return np.asarray(self(node)[0])

    @property
    def _positions(self) -> Any:
        return self.first + np.arange(len(self.values[0]))

    def _atom(self, margin: Floats, scale: float) -> Floats:
        held = np.minimum(scale / (scale + np.maximum(margin, 0.0)), _NEARLY)
        return np.where(margin > 0, held, 1.0)

    def _deficit(self, node: f.Node) -> Floats:
        """(N,) how far the newest sample is from making the formula true, in [0, 1)."""
        if isinstance(node, Atom):
            missing = np.clip(-self.values[node.index][-1], 0.0, 1e300)
            return np.asarray(missing / (self.scales[node.index] + missing))
        return np.asarray(np.minimum(self(node)[-1], _NEARLY))

    def _allowed(self, lo: int, hi: float) -> tuple[Floats, Floats]:
        """(W, 1) samples where a witness may lie, in all and so far."""
        position = self._positions[:, None]
        begin, end = position + lo, np.minimum(position + hi, self.last)
        newest = position[-1, 0]
        return np.maximum(end - begin + 1, 0), np.maximum(np.minimum(end, newest) - begin + 1, 0)

    def _eventually(self, x: Floats, deficit: Floats, lo: int, hi: float) -> Floats:
        allowed, seen = self._allowed(lo, hi)
        best = np.minimum(sliding(x, lo, hi, np.minimum), 1.0)
        return np.asarray(_waiting(best, deficit, allowed, seen))

    def _until(self, node: f.Until) -> Floats:
        left, right = self(node.left), self(node.right)
        return np.stack([self._until_at(node, left, right, i) for i in range(len(left))])

    def _until_at(self, node: f.Until, left: Floats, right: Floats, i: int) -> Floats:
        """(N,) danger of until at position ``i``: the left operand has failed, or no witness comes."""
        allowed, seen = self._allowed(node.lo, node.hi)
        held = np.maximum.accumulate(left[i:], axis=0)
        end = int(min(node.hi, len(held) - 1)) + 1
        best = np.maximum(right[i + node.lo : i + end], held[node.lo : end]).min(axis=0, initial=1.0)
        waiting = _waiting(best, self._deficit(node.right), allowed[i], seen[i])
        return np.where(best < 1.0, waiting, np.maximum(waiting, held[-1]))

    def _next(self, op: str, x: Floats) -> Floats:
        out = np.zeros_like(x)
        out[:-1] = x[1:]
        if self._positions[-1] == self.last:
            out[-1] = 0.0 if op == "next" else 1.0
        return out


def _waiting(best: Floats, deficit: Floats, allowed: Floats, seen: Floats) -> Floats:
    """Danger of an eventuality from its least dangerous witness so far (1: none)."""
    many = np.maximum(allowed, 1)
    spent = np.where(seen > 0, (seen - 1 + deficit) / many, 0.0)
    spent = np.where(seen >= allowed, 1.0, np.minimum(spent, _NEARLY))
    return np.where(best < 1.0, best / many, spent)
