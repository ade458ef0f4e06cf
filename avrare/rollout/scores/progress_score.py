"""Progress score for formulas that may still become true: their danger at every step.

The danger of a formula is how near it is to being violated, in [0, 1].

Robustness of a prefix is a poor guide where a formula may still become true: ``eventually (x > 1)`` is most
violated at its start. Danger measures what is left instead. It is 1 exactly where the formula is certainly
violated, and otherwise:

- a known part that holds with margin v has lost the share 1 - v / s of its typical size s, where v < s;
  beyond that its danger stays below 0.01, so that it does not mask what is pending;
- ``eventually`` without a witness has danger (samples seen - 1 + deficit of the newest) / samples allowed,
  the share of time that has passed, with ties broken by the distance of the newest sample;
- ``and``, ``always`` and until have the largest danger of their operands, ``or`` the least.

Samples beyond the end of the rollout count as passed: at the last sample nothing is pending.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from avrare.logic.formula import Formula, FormulaMonitor
from avrare.logic.monitor.monitors import RobustnessMonitor
from avrare.logic.semantics.value_algebra import TINY
from avrare.logic.semantics.window_operators import slide
from avrare.logic.syntax import nodes
from avrare.protocols import Floats, Signals, Specification, Verdict
from avrare.rollout.scores.term_sizes import ScaledMonitor

_NEARLY = math.nextafter(1.0, 0.0)
Pair = tuple[nodes.Node, nodes.Node]
_OPPOSITE = {"always": "eventually", "eventually": "always", "next": "s_next", "s_next": "next"}


@dataclass(frozen=True)
class Atom(nodes.Node):
    """Maximal past-only part of a formula; its margin comes from a monitor of its own."""

    index: int


def positive(node: nodes.Node, atoms: list[nodes.Node], negated: bool = False) -> nodes.Node | None:
    """Push negations down to past-only parts, added to ``found``; None where that is not possible."""
    if nodes.horizon(node) == 0:
        atoms.append(nodes.Not(node) if negated else node)
        return Atom(len(atoms) - 1)
    match node:
        case nodes.Not(child):
            return positive(child, atoms, not negated)
        case nodes.Connective("and" | "or" | "implies" as op, left, right):
            flip = negated != (op == "implies")
            sides = positive(left, atoms, flip), positive(right, atoms, negated)
            op = "and" if (op == "and") != negated else "or"
            return nodes.Connective(op, *cast(Pair, sides)) if all(sides) else None
        case nodes.Window("always" | "eventually" as op, lo, hi, child):
            inner = positive(child, atoms, negated)
            return nodes.Window(_OPPOSITE[op] if negated else op, lo, hi, inner) if inner else None
        case nodes.Until("until", lo, hi, left, right) if not negated:
            sides = positive(left, atoms), positive(right, atoms)
            return nodes.Until("until", lo, hi, *cast(Pair, sides)) if all(sides) else None
        case nodes.Step("next" | "s_next" as op, child):
            inner = positive(child, atoms, negated)
            return nodes.Step(_OPPOSITE[op] if negated else op, inner) if inner else None
        case _:
            return None


@dataclass(frozen=True)
class Danger:
    """Danger of formulas in positive form, at every position of a window of samples."""

    values: Sequence[Floats]  # per atom, (W, N) margins in the window, oldest first; positive where it holds
    first: int  # index of the window's first sample in the trace
    last: int  # index of the trace's last sample
    scales: Sequence[float]  # typical size of each atom

    def __call__(self, node: nodes.Node) -> Floats:
        """Return danger (W, N) at each position, given the samples up to the window's newest."""
        match node:
            case Atom(index):
                return self._atom(self.values[index], self.scales[index])
            case nodes.Connective("and", left, right):
                return np.maximum(self(left), self(right))
            case nodes.Connective(_, left, right):
                return np.minimum(self(left), self(right))
            case nodes.Window("always", lo, hi, child):
                return np.maximum(slide(self(child), lo, hi, np.maximum), 0.0)
            case nodes.Window(_, lo, hi, child):
                return self._eventually(self(child), self._deficit(child), lo, hi)
            case nodes.Until():
                return self._until(node)
            case nodes.Step(op, child):
                return self._next(op, self(child))
        raise TypeError(f"not in positive form: {node!r}")

    def at_first(self, node: nodes.Node) -> Floats:
        """Return danger (N,) at the first position only."""
        match node:
            case nodes.Connective(op, left, right):
                join = np.maximum if op == "and" else np.minimum
                return join(self.at_first(left), self.at_first(right))
            case nodes.Until(_, _, _, left, right):
                return self._until_at(node, self(left), self(right), 0)
            case _:
                return np.asarray(self(node)[0])

    @property
    def _positions(self) -> Any:
        return self.first + np.arange(len(self.values[0]))

    def _atom(self, margin: Floats, scale: float) -> Floats:
        typical_danger = 0.01
        lost = 1.0 - (1.0 - typical_danger) * margin / scale
        held = np.where(margin < scale, np.minimum(lost, _NEARLY), typical_danger * scale / margin)
        return np.where(margin > 0, held, 1.0)

    def _deficit(self, node: nodes.Node) -> Floats:
        # (N,) the distance of the newest sample from making the formula true, in [0, 1).
        if isinstance(node, Atom):
            missing = np.clip(-self.values[node.index][-1], 0.0, 1e300)
            return np.asarray(missing / (self.scales[node.index] + missing))
        return np.asarray(np.minimum(self(node)[-1], _NEARLY))

    def _find_allowed(self, lo: int, hi: float) -> tuple[Floats, Floats]:
        # (W, 1) numbers of samples where a witness may lie: in total, and so far.
        position = self._positions[:, None]
        begin, end = position + lo, np.minimum(position + hi, self.last)
        newest = position[-1, 0]
        return np.maximum(end - begin + 1, 0), np.maximum(np.minimum(end, newest) - begin + 1, 0)

    def _eventually(self, x: Floats, deficit: Floats, lo: int, hi: float) -> Floats:
        allowed, past = self._find_allowed(lo, hi)
        best = np.minimum(slide(x, lo, hi, np.minimum), 1.0)
        return np.asarray(_waiting(best, deficit, allowed, past))

    def _until(self, node: nodes.Until) -> Floats:
        left, right = self(node.left), self(node.right)
        return np.stack([self._until_at(node, left, right, i) for i in range(len(left))])

    def _until_at(self, node: nodes.Until, left: Floats, right: Floats, i: int) -> Floats:
        allowed, past = self._find_allowed(node.lo, node.hi)
        held = np.maximum.accumulate(left[i:], axis=0)
        end = int(min(node.hi, len(held) - 1)) + 1
        best = np.maximum(right[i + node.lo : i + end], held[node.lo : end]).min(axis=0, initial=1.0)
        waiting = _waiting(best, self._deficit(node.right), allowed[i], past[i])
        return np.where(best < 1.0, waiting, np.maximum(waiting, held[-1]))

    def _next(self, op: str, x: Floats) -> Floats:
        out = np.zeros_like(x)
        out[:-1] = x[1:]
        if self._positions[-1] == self.last:
            out[-1] = 0.0 if op == "next" else 1.0
        return out


def _waiting(best: Floats, deficit: Floats, allowed: Floats, seen: Floats) -> Floats:
    # The danger of an eventuality, given that of its best witness so far (1: none).
    many = np.maximum(allowed, 1)
    used_share = np.where(seen > 0, (seen - 1 + deficit) / many, 0.0)
    used_share = np.where(seen >= allowed, 1.0, np.minimum(used_share, _NEARLY))
    return np.where(best < 1.0, best / many, used_share)


@dataclass(frozen=True)
class Shape:
    """Formula in the form that the score is computed from."""

    body: nodes.Node  # in positive form; for ``always φ`` over the complete rollout, φ
    atoms: tuple[nodes.Node, ...]  # past-only parts of the formula
    repeated: bool  # True where the body must hold at every sample, False: at the first
    window: float  # number of samples that the body depends on


def shape_of(formula: Formula) -> Shape | None:
    """Return the shape by which to score a formula, or None where this score does not apply.

    It does not apply to ``always`` of a past-only formula, where nothing is ever pending and robustness or
    margin suffice, nor where negations cannot be pushed down to past-only parts: quantifiers, iff, xor or a
    negated until over the future.
    """
    atoms: list[nodes.Node] = []
    body = positive(formula.node, atoms)
    match body:
        case None:
            return None
        case nodes.Window("always", 0, math.inf, child):
            pending = nodes.horizon(child)
            return Shape(child, tuple(atoms), True, pending + 1) if pending else None
        case _:
            return Shape(body, tuple(atoms), False, math.inf) if nodes.horizon(body) else None


@dataclass(frozen=True)
class ProgressState:
    """State of a progress score."""

    inner: Any  # of the formula's monitor
    atoms: tuple[Any, ...]  # of the atoms' monitors
    values: tuple[Floats, ...] | None  # per atom, (N, W) margins at the newest samples
    settled: Floats  # (N,) largest danger of the positions that have left the window
    score: Floats  # (N,) running maximum
    t: int  # number of samples so far


class ProgressScored(Specification):
    """Formula scored by its danger; 1 exactly where a complete rollout violates it.

    Args:
        inner: Monitor of the formula.
        shape: Shape of the formula, or of the guide's.
        steps: Last step of a rollout.
        nominal: Signals of the noise-free rollout, which give the atoms' typical sizes; None: 1.
        guide: Monitor whose formula is scored in place of the inner one's; it decides nothing.
    """

    def __init__(
        self,
        inner: FormulaMonitor,
        shape: Shape,
        steps: int,
        nominal: Sequence[Signals] | None = None,
        guide: ScaledMonitor | None = None,
    ) -> None:
        self.inner, self.shape, self.steps, self.guide = inner, shape, steps, guide
        formula = inner.formula
        always = [nodes.Window("always", 0, math.inf, atom) for atom in shape.atoms]
        self._atoms = [RobustnessMonitor(node, formula.closed) for node in always]
        self._scales = [1.0] * len(self._atoms)
        if nominal:
            samples = [self._sample(signals, t) for t, signals in enumerate(nominal)]
            self._scales = [_typical_size(monitor, samples) for monitor in self._atoms]

    def start(self, n: int) -> ProgressState:
        """Return the state before sample 0."""
        atoms = tuple(monitor.start(n) for monitor in self._atoms)
        return ProgressState(self.inner.start(n), atoms, None, np.zeros(n), np.full(n, -np.inf), 0)

    def update(self, state: ProgressState, signals: Signals) -> tuple[ProgressState, Verdict]:
        """Return state and verdict after one more sample."""
        inner, verdict = self.inner.update(state.inner, signals)
        sample = self._sample(signals, state.t)
        pairs = [m.update(s, sample)[0] for m, s in zip(self._atoms, state.atoms, strict=True)]
        newest = [_signed_margin(m, s)[:, None] for m, s in zip(self._atoms, pairs, strict=True)]
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

    def margin(self, state: ProgressState) -> Floats | None:
        """Return the margin of the inner monitor."""
        return self.inner.margin(state.inner)

    def _sample(self, signals: Signals, t: int) -> Signals:
        return signals if self.guide is None else self.guide.sample_at(signals, t)

    def _danger(self, values: tuple[Floats, ...], state: ProgressState) -> tuple[Floats, Floats]:
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


def _margin(monitor: RobustnessMonitor, state: Any) -> Floats:
    margin = monitor.margin(state)
    assert margin is not None  # the monitor's formula is `always` of a past-only formula
    return margin


def _signed_margin(monitor: RobustnessMonitor, state: Any) -> Floats:
    # A margin of 0 is true in `x >= 1` and false in `x > 1`.
    margin = _margin(monitor, state)
    return np.where(monitor.holds(state), np.maximum(margin, TINY), np.minimum(margin, -TINY))


def _typical_size(monitor: RobustnessMonitor, nominal: Sequence[Signals]) -> float:
    state, sizes = monitor.start(1), []
    for signals in nominal:
        state, _ = monitor.update(state, signals)
        sizes.append(abs(float(_margin(monitor, state)[0])))
    finite = [size for size in sizes if math.isfinite(size)]
    mean = sum(finite) / len(finite) if finite else 0.0
    return mean or 1.0
