"""What the value of a sub-formula at one sample is made of."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic import formula as f
from avrare.logic.robustness import joining

Array = NDArray[Any]


@dataclass(frozen=True)
class Binding:
    """A quantified variable's member: its index, and its name where the group's members have names."""

    variable: str
    group: str
    index: int
    name: str | None

    @property
    def label(self) -> str:
        """What stands for the variable in text."""
        return f"{self.group}[{self.index}]" if self.name is None else self.name


@dataclass(frozen=True)
class Place:
    """A sub-formula at a sample, below quantifiers whose variables are bound (outermost first)."""

    node: f.Node
    sample: int
    bindings: tuple[Binding, ...] = ()

    def pick(self, values: Array) -> float:
        """Its number among the values (T, 1, ...) of its node."""
        row = values[self.sample, 0]
        bound = zip(self.bindings, row.shape, strict=False)
        return float(row[tuple(binding.index if size > 1 else 0 for binding, size in bound)])


@dataclass(frozen=True)
class Part:
    """An operand at a sample.

    Attributes:
        place: Where.
        share: What it contributes: its margin, or minus that where it is negated.
        holds: Whether the contribution is true.
    """

    place: Place
    share: float
    holds: bool


@dataclass(frozen=True)
class Parts:
    """What a value is made of: the minimum or maximum of the shares, or the ``count``-th largest."""

    parts: Sequence[Part]
    join: np.ufunc = np.minimum
    count: int | None = None

    def decisive(self) -> Part:
        """The part whose share is the value."""
        if self.count is not None:
            return sorted(self.parts, key=lambda part: -part.share)[self.count - 1]
        choose = min if self.join is np.minimum else max
        return choose(self.parts, key=lambda part: part.share)

    def sufficient(self) -> list[Part]:
        """The parts each of which alone makes a minimum false or a maximum true."""
        if self.count is not None:
            return []
        return [part for part in self.parts if part.holds != (self.join is np.minimum)]


@dataclass(frozen=True)
class Values:
    """Values of all sub-formulas on one trace.

    Attributes:
        margins: Robustness (T, 1, ...) of every sub-formula.
        truths: The same, but its sign the truth.
        members: group -> names of its vehicles.
        closed: Whether until and since need their left operand at the witness.
    """

    margins: Mapping[f.Node, Array]
    truths: Mapping[f.Node, Array]
    members: Mapping[str, Sequence[str]]
    closed: bool

    def parts(self, place: Place) -> Parts:
        """What the value of a place is made of; no parts where there is nothing below or no sample."""
        node, i = place.node, place.sample
        match node:
            case f.Not(child):
                return Parts([self._part(place, child, i, -1)])
            case f.Connective("iff" | "xor", left, right):
                parts = [self._part(place, child, i) for child in (left, right)]
                return Parts([dataclasses.replace(part, share=abs(part.share)) for part in parts])
            case f.Connective(op, left, right):
                sign = -1 if op == "implies" else 1
                parts = [self._part(place, left, i, sign), self._part(place, right, i)]
                return Parts(parts, np.minimum if op == "and" else np.maximum)
            case f.Quantifier():
                return self._members(place, node)
            case f.Window(op, lo, hi, child):
                span = self._span(i, lo, hi, op in f.PAST)
                return Parts([self._part(place, child, k) for k in span], joining(op))
            case f.Until(op="unless"):
                return self.parts(dataclasses.replace(place, node=f.expand_unless(node)))
            case f.Until():
                return Parts(self._until(place, node))
            case f.Step(op, child):
                return Parts(self._step(place, op, child))
        return Parts([])

    def _part(self, place: Place, node: f.Node, sample: int, sign: int = 1) -> Part:
        at = dataclasses.replace(place, node=node, sample=sample)
        return Part(at, sign * at.pick(self.margins[node]), sign * at.pick(self.truths[node]) > 0)

    def _span(self, i: int, lo: int, hi: float, past: bool) -> range:
        if past:
            return range(i - lo, int(max(0, i - hi)) - 1, -1)
        steps = len(next(iter(self.margins.values())))
        return range(i + lo, int(min(i + hi, steps - 1)) + 1)

    def _step(self, place: Place, op: str, child: f.Node) -> list[Part]:
        i = place.sample
        if op in ("rise", "fall"):
            sign = 1 if op == "rise" else -1
            before = [self._part(place, child, i - 1, -sign)] if i else []
            return [*before, self._part(place, child, i, sign)]
        past = op in f.PAST
        return [self._part(place, child, k) for k in self._span(i, 1, 1, past)]

    def _until(self, place: Place, node: f.Until) -> list[Part]:
        """The witness that makes most of it, and the left operand up to there."""
        i, best = place.sample, -np.inf
        held: list[Part] = []
        needed: list[Part] = []
        for k in self._span(i, 0, node.hi, node.op in f.PAST):
            left, right = self._part(place, node.left, k), self._part(place, node.right, k)
            now = [*held, left, right] if self.closed else [*held, right]
            held.append(left)
            value = min(part.share for part in now)
            if abs(k - i) >= node.lo and (value > best or not needed):
                best, needed = value, now
        return needed

    def _members(self, place: Place, node: f.Quantifier) -> Parts:
        names = self.members.get(node.group)
        parts = []
        for v in range(self.margins[node.child].shape[2 + node.depth]):
            binding = Binding(node.variable, node.group, v, str(names[v]) if names else None)
            bound = dataclasses.replace(place, bindings=(*place.bindings, binding))
            parts.append(self._part(bound, node.child, place.sample))
        if node.op == "at_least":
            return Parts(parts if len(parts) >= node.count else [], count=node.count)
        return Parts(parts, np.minimum if node.op == "forall" else np.maximum)
