"""Explanation of a robustness: the sample, the vehicle and the comparison that decide it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from avrare.base.errors import FormulaError
from avrare.logic.semantics.trace_evaluator import get_join
from avrare.logic.semantics.value_algebra import TINY
from avrare.logic.semantics.window_operators import Array
from avrare.logic.syntax import nodes
from avrare.logic.syntax.printer import to_text


@dataclass(frozen=True)
class Link:
    """One level of the descent from a formula to the comparison that decides it.

    Attributes:
        text: Sub-formula, with the names of its bound vehicles.
        sample: Sample at which it is evaluated.
        value: Robustness at that sample.
    """

    text: str
    sample: int
    value: float


@dataclass(frozen=True)
class Cause:
    """Descent from a formula to the comparison that decides it.

    Attributes:
        sample: Sample at which the operand of the outermost temporal operator decides.
        bindings: variable -> name of the member, or its index if the group's members have no names.
        chain: Levels of the descent, the whole formula first.
    """

    sample: int
    bindings: dict[str, str | int]
    chain: tuple[Link, ...]


@dataclass(frozen=True)
class Explanation:
    """Explanation of a formula at sample 0 of one trace.

    Attributes:
        robustness: Robustness of the formula.
        violated: True if the formula is false.
        first: Sample of the earliest cause: for a violated ``always``, the first at which its operand is
            false.
        worst: Sample that decides the robustness: for ``always``, where its operand is smallest.
        bindings: variable -> member, for the quantifiers on the way to the worst.
        formula: Sub-formula that decides the robustness, with the names of its bound vehicles.
        value: Robustness of that sub-formula.
        chain: Descent from the whole formula to that sub-formula.
        earliest: Descent to the earliest cause, which may be another vehicle's.
    """

    robustness: float
    violated: bool
    first: int
    worst: int
    bindings: dict[str, str | int]
    formula: str
    value: float
    chain: tuple[Link, ...]
    earliest: Cause


class _Binding(NamedTuple):
    """Member of a group that a quantified variable is bound to.

    Attributes:
        variable: Variable.
        member: Index in the group.
        name: Name of the member, or its index if the group's members have no names.
        label: Member in the text of a formula.
    """

    variable: str
    member: int
    name: str | int
    label: str


class _Place(NamedTuple):
    """Sub-formula at a sample, below quantifiers whose variables are bound (outermost first)."""

    node: nodes.Node
    sample: int
    bindings: tuple[_Binding, ...] = ()

    def pick(self, values: Mapping[nodes.Node, Array]) -> float:
        row = values[self.node][self.sample, 0]
        bound = zip(self.bindings, row.shape, strict=False)
        return float(row[tuple(binding.member if size > 1 else 0 for binding, size in bound)])


class _Operand(NamedTuple):
    """Operand at a sample.

    Attributes:
        place: Sub-formula and sample.
        share: Contribution to the value: the operand's margin, negated under a negation.
        holds: True if the contribution is true.
    """

    place: _Place
    share: float
    holds: bool


class _Operands(NamedTuple):
    """Operands of a value: the minimum or maximum of their shares, or the largest but ``rank`` - 1."""

    parts: Sequence[_Operand]
    join: np.ufunc = np.minimum
    rank: int | None = None

    def find_decisive(self) -> _Operand:
        if self.rank is not None:
            return sorted(self.parts, key=lambda part: -part.share)[self.rank - 1]
        choose = min if self.join is np.minimum else max
        return choose(self.parts, key=lambda part: part.share)

    def find_sufficient(self) -> list[_Operand]:
        # Each of these alone makes a minimum false, or a maximum true.
        if self.rank is not None:
            return []
        return [part for part in self.parts if part.holds != (self.join is np.minimum)]


@dataclass(frozen=True)
class FormulaValues:
    """Values of all sub-formulas on one trace.

    Attributes:
        margins: Robustness (T, 1, ...) of every sub-formula.
        truths: Values (T, 1, ...) whose signs are the truth.
        members: group -> names of its vehicles.
        closed: True if until and since need their left operand at the witness.
    """

    margins: Mapping[nodes.Node, Array]
    truths: Mapping[nodes.Node, Array]
    members: Mapping[str, Sequence[str]]
    closed: bool

    def explain(self, node: nodes.Node) -> Explanation:
        """Explain the formula."""
        root = _Place(node, 0)
        worst, earliest = self._descend(root, early=False), self._descend(root, early=True)
        last = worst.chain[-1]
        return Explanation(
            robustness=worst.chain[0].value,
            violated=root.pick(self.truths) < 0,
            first=earliest.sample,
            worst=worst.sample,
            bindings=worst.bindings,
            formula=last.text,
            value=last.value,
            chain=worst.chain,
            earliest=earliest,
        )

    def _descend(self, place: _Place, early: bool) -> Cause:
        # 1. The link of this level.
        value, node = place.pick(self.margins), place.node
        text = to_text(node, {binding.variable: binding.label for binding in place.bindings})
        link = Link(text, place.sample, 0.0 if abs(value) <= TINY else value)
        operands = self._find_operands(place)
        if not operands.parts:
            return Cause(place.sample, {x.variable: x.name for x in place.bindings}, (link,))
        # 2. The operands to descend to: sufficient ones (of a temporal operator the earliest), or the
        #    decisive one.
        temporal = isinstance(node, nodes.Window | nodes.Until | nodes.Step) and node.op != "unless"
        chosen = operands.find_sufficient() if early else []
        if chosen and temporal:
            chosen = [min(chosen, key=lambda part: part.place.sample)]
        # 3. The earliest of their causes.
        causes = []
        for part in chosen or [operands.find_decisive()]:
            cause = self._descend(part.place, early)
            causes.append(replace(cause, sample=part.place.sample) if temporal else cause)
        first = min(causes, key=lambda cause: cause.sample)
        return replace(first, chain=(link, *first.chain))

    def _find_operands(self, place: _Place) -> _Operands:
        # Comparisons and empty windows have none.
        node, i = place.node, place.sample
        match node:
            case nodes.Not(child):
                return _Operands([self._operand(place, child, i, -1)])
            case nodes.Connective("iff" | "xor", left, right):
                parts = [self._operand(place, child, i) for child in (left, right)]
                return _Operands([part._replace(share=abs(part.share)) for part in parts])
            case nodes.Connective(op, left, right):
                sign = -1 if op == "implies" else 1
                parts = [self._operand(place, left, i, sign), self._operand(place, right, i)]
                return _Operands(parts, np.minimum if op == "and" else np.maximum)
            case nodes.Quantifier():
                return self._find_members(place, node)
            case nodes.Window(op, lo, hi, child):
                span = self._span(i, lo, hi, op in nodes.PAST)
                return _Operands([self._operand(place, child, k) for k in span], get_join(op))
            case nodes.Step("rise" | "fall" as op, child):
                sign = 1 if op == "rise" else -1
                before = [self._operand(place, child, i - 1, -sign)] if i else []
                return _Operands([*before, self._operand(place, child, i, sign)])
            case nodes.Step() | nodes.Until(op="unless"):
                return self._find_operands(place._replace(node=nodes.expand(node)))
            case nodes.Until():
                return _Operands(self._find_witness(place, node))
        return _Operands([])

    def _operand(
        self, place: _Place, node: nodes.Node, sample: int, sign: int = 1, *binding: _Binding
    ) -> _Operand:
        at = _Place(node, sample, (*place.bindings, *binding))
        return _Operand(at, sign * at.pick(self.margins), sign * at.pick(self.truths) > 0)

    def _span(self, i: int, lo: int, hi: float, past: bool) -> range:
        if past:
            return range(i - lo, int(max(0, i - hi)) - 1, -1)
        steps = len(next(iter(self.margins.values())))
        return range(i + lo, int(min(i + hi, steps - 1)) + 1)

    def _find_witness(self, place: _Place, node: nodes.Until) -> list[_Operand]:
        i, best = place.sample, -np.inf
        held: list[_Operand] = []
        needed: list[_Operand] = []
        for k in self._span(i, 0, node.hi, node.op in nodes.PAST):
            left, right = self._operand(place, node.left, k), self._operand(place, node.right, k)
            now = [*held, left, right] if self.closed else [*held, right]
            held.append(left)
            value = min(part.share for part in now)
            if abs(k - i) >= node.lo and (value > best or not needed):
                best, needed = value, now
        return needed

    def _find_members(self, place: _Place, node: nodes.Quantifier) -> _Operands:
        names = self.members.get(node.group)
        parts = []
        for v in range(self.margins[node.child].shape[2 + node.depth]):
            binding = _Binding(node.variable, v, v, f"{node.group}[{v}]")
            if names:
                binding = binding._replace(name=str(names[v]), label=str(names[v]))
            parts.append(self._operand(place, node.child, place.sample, 1, binding))
        if node.op == "at_least":
            return _Operands(parts if len(parts) >= node.count else [], rank=node.count)
        return _Operands(parts, np.minimum if node.op == "forall" else np.maximum)


def to_single_trace(signals: Mapping[str, object], node: nodes.Node) -> Mapping[str, object]:
    """Return the signals of one trace, (T, ...) or (1, T, ...) each, as (1, T, ...).

    The formula's relations determine how many axes a sample has. Invalid signals are refused later.
    """
    names: Sequence[str] = nodes.signals(node) or list(signals)[:1]
    arrays = {name: x for name in names if isinstance(x := signals.get(name), np.ndarray)}
    parts = list(nodes.walk(node))
    axes = {part.name: len(part.axes) for part in parts if isinstance(part, nodes.Signal) and part.arguments}
    lead = {arrays[name].ndim - count for name, count in axes.items() if name in arrays}
    lead |= {1 for x in arrays.values() if x.ndim == 1}
    several = any(isinstance(part, nodes.Quantifier) for part in parts)
    batched = min(lead) > 1 if lead else not several or all(len(x) == 1 for x in arrays.values())
    if batched and any(len(x) != 1 for x in arrays.values()):
        raise FormulaError("only one trace can be explained at a time", "give signals (T,), relations (T, V)")
    return {**signals, **{name: x if batched else x[None] for name, x in arrays.items()}}
