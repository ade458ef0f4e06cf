"""Formulas of signal temporal logic over sampled signals, as values.

Bounds are whole samples (``hi`` may be ``math.inf``); windows are closed. ``horizon`` and ``history`` say how
far ahead and back a formula looks, which decides what a monitor has to remember.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

FUTURE = frozenset({"always", "eventually", "until", "release", "unless", "next", "s_next"})
PAST = frozenset({"historically", "once", "since", "trigger", "prev", "s_prev", "rise", "fall"})


@dataclass(frozen=True)
class Term:
    """A number at every sample."""


@dataclass(frozen=True)
class Number(Term):
    """A constant."""

    value: float


@dataclass(frozen=True)
class Signal(Term):
    """The sample of a named signal, or of a relation between vehicles such as ``in_front_of(o, ego)``.

    Attributes:
        name: The key of its samples: ``speed``, or ``in_front_of(others, ego)``, where a quantified vehicle
            stands as the group that it ranges over.
        arguments: The vehicles as written: ``("o", "ego")``; empty for a plain signal.
        axes: Of a relation, per quantified argument the number of quantifiers around the one that binds it:
            the samples' trailing axes in the same order belong to them.
    """

    name: str
    arguments: tuple[str, ...] = ()
    axes: tuple[int, ...] = ()


@dataclass(frozen=True)
class Negative(Term):
    """Minus a term."""

    operand: Term


@dataclass(frozen=True)
class Arithmetic(Term):
    """``left op right`` with op one of ``+ - * /``."""

    op: str
    left: Term
    right: Term


@dataclass(frozen=True)
class Call(Term):
    """A function: abs, sqrt, exp, log, min, max, pow."""

    function: str
    arguments: tuple[Term, ...]


@dataclass(frozen=True)
class Node:
    """A formula: true or false, with a robustness, at every sample."""


@dataclass(frozen=True)
class Constant(Node):
    """``true`` or ``false``."""

    value: bool


@dataclass(frozen=True)
class Predicate(Node):
    """A bare term: true iff it is above zero; its robustness is its value."""

    term: Term


@dataclass(frozen=True)
class Comparison(Node):
    """``left op right`` with op one of ``< <= > >= == !=``."""

    op: str
    left: Term
    right: Term


@dataclass(frozen=True)
class Not(Node):
    """Negation."""

    child: Node


@dataclass(frozen=True)
class Connective(Node):
    """``left op right`` with op one of and, or, implies, iff, xor."""

    op: str
    left: Node
    right: Node


@dataclass(frozen=True)
class Window(Node):
    """always, eventually, historically or once, over the samples ``lo`` to ``hi`` ahead or back."""

    op: str
    lo: int
    hi: float
    child: Node


@dataclass(frozen=True)
class Until(Node):
    """``left op right`` with op one of until, since, unless; the witness is ``lo`` to ``hi`` samples away.

    Monitors also make release and trigger, the duals of until and since.
    """

    op: str
    lo: int
    hi: float
    left: Node
    right: Node


@dataclass(frozen=True)
class Step(Node):
    """next, prev (true outside the trace), s_next, s_prev (false outside), rise, fall."""

    op: str
    child: Node


@dataclass(frozen=True)
class Quantifier(Node):
    """``op variable in group: child``, an order statistic over one trailing axis of the child's values.

    Attributes:
        op: forall (the minimum), exists (the maximum) or at_least (the ``count``-th largest).
        variable: The name that stands for a member of the group.
        group: What it ranges over, such as ``others``.
        child: The formula.
        depth: Number of quantifiers around this one, which is also the trailing axis that it reduces.
        count: Of at_least.
    """

    op: str
    variable: str
    group: str
    child: Node
    depth: int = 0
    count: int = 1


@dataclass(frozen=True)
class Slot(Node):
    """A formula whose values are computed elsewhere; only monitors make these."""

    index: int


def parts(item: Node | Term) -> Iterator[Node | Term]:
    """The direct parts of a formula or term, left to right."""
    for field in dataclasses.fields(item):
        value = getattr(item, field.name)
        if isinstance(value, Node | Term):
            yield value
        elif isinstance(value, tuple):
            yield from (part for part in value if isinstance(part, Node | Term))


def children(node: Node) -> list[Node]:
    """The direct sub-formulas."""
    return [part for part in parts(node) if isinstance(part, Node)]


def walk(item: Node | Term) -> Iterator[Node | Term]:
    """The formula and everything below it."""
    yield item
    for part in parts(item):
        yield from walk(part)


def rebuild(node: Node, change: Callable[[Node], Node]) -> Node:
    """The formula with ``change`` applied to its direct sub-formulas."""
    found = {field.name: getattr(node, field.name) for field in dataclasses.fields(node)}
    changed = {name: change(value) for name, value in found.items() if isinstance(value, Node)}
    return dataclasses.replace(node, **changed) if changed else node


def signals(item: Node | Term) -> tuple[str, ...]:
    """The names of the signals used, in order of appearance."""
    return tuple(dict.fromkeys(part.name for part in walk(item) if isinstance(part, Signal)))


def depth(node: Node | Term) -> int:
    """How deeply the formula is nested; a signal counts 1."""
    return 1 + max((depth(part) for part in parts(node)), default=0)


def _reach(node: Node, operators: frozenset[str]) -> float:
    below = max((_reach(child, operators) for child in children(node)), default=0)
    match node:
        case Window(op=op, hi=hi) | Until(op=op, hi=hi) if op in operators:
            return below + hi
        case Step(op=op) if op in operators:
            return below + 1
        case _:
            return below


def horizon(node: Node) -> float:
    """Samples that the formula looks ahead: nested future bounds added up, ``math.inf`` if unbounded."""
    return _reach(node, FUTURE)


def history(node: Node) -> float:
    """Samples that the formula looks back: nested past bounds added up, ``math.inf`` if unbounded."""
    return _reach(node, PAST)


def bounded_span(node: Node) -> int:
    """Samples that the bounded parts of a formula look ahead, nested ones added up.

    An unbounded operator counts with the bound that it has, at which it begins.
    """
    below = max((bounded_span(child) for child in children(node)), default=0)
    match node:
        case Window(op=op, lo=lo, hi=hi) | Until(op=op, lo=lo, hi=hi) if op in FUTURE:
            return below + int(lo if math.isinf(hi) else hi)
        case Step(op=op) if op in FUTURE:
            return below + 1
    return below


def settling(node: Node) -> int:
    """Samples after which the formula's value repeats once its signals do.

    Like ``history``, but an unbounded past operator settles one sample after its operands have.
    """
    below = max((settling(child) for child in children(node)), default=0)
    match node:
        case Window(op=op, lo=lo, hi=hi) | Until(op=op, lo=lo, hi=hi) if op in PAST:
            return below + (lo + 1 if math.isinf(hi) else int(hi))
        case Step(op=op) if op in PAST:
            return below + 1
        case _:
            return below


def expand_unless(node: Until) -> Node:
    """``l unless[a,b] r`` as ``always[0,b] l or l until[a,b] r``."""
    kept = Window("always", 0, node.hi, node.left)
    return Connective("or", kept, Until("until", node.lo, node.hi, node.left, node.right))
