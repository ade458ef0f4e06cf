"""Syntax tree of signal temporal logic over sampled signals.

Bounds are whole samples (``hi`` may be ``math.inf``); windows include both ends. ``horizon`` and ``history``
give how far ahead and back a formula looks, which determines what a monitor has to remember.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeGuard

FUTURE = frozenset({"always", "eventually", "until", "release", "unless", "next", "s_next"})
PAST = frozenset({"historically", "once", "since", "trigger", "prev", "s_prev", "rise", "fall"})
_STEPS = {"next": "always", "s_next": "eventually", "prev": "historically", "s_prev": "once"}


@dataclass(frozen=True)
class Term:
    """Arithmetic expression: a number at every sample."""


@dataclass(frozen=True)
class Number(Term):
    """Numeric constant."""

    value: float


@dataclass(frozen=True)
class Signal(Term):
    """Named signal, or relation between vehicles such as ``in_front_of(o, ego)``.

    Attributes:
        name: Key of the samples: ``speed``, or ``in_front_of(others, ego)``, with each quantified vehicle
            replaced by the group that it ranges over.
        arguments: Vehicles as written, ``("o", "ego")``; empty for a plain signal.
        axes: Depth of the quantifier that binds each quantified argument, in the order of the samples'
            trailing axes; empty for a plain signal.
    """

    name: str
    arguments: tuple[str, ...] = ()
    axes: tuple[int, ...] = ()


@dataclass(frozen=True)
class Negative(Term):
    """Negated term."""

    operand: Term


@dataclass(frozen=True)
class Arithmetic(Term):
    """``left op right`` with op one of ``+ - * /``."""

    op: str
    left: Term
    right: Term


@dataclass(frozen=True)
class Call(Term):
    """Function call: abs, sqrt, exp, log, min, max or pow."""

    function: str
    arguments: tuple[Term, ...]


@dataclass(frozen=True)
class Node:
    """Formula: true or false, with a robustness, at every sample."""


@dataclass(frozen=True)
class Constant(Node):
    """``true`` or ``false``."""

    value: bool


@dataclass(frozen=True)
class Predicate(Node):
    """Bare term: true iff it is above zero; its robustness is its value."""

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
    """Unary temporal operator: always, eventually, historically or once, ``lo`` to ``hi`` samples away."""

    op: str
    lo: int
    hi: float
    child: Node


@dataclass(frozen=True)
class Until(Node):
    """``left op right`` with op one of until, since, unless; the witness is ``lo`` to ``hi`` samples away.

    Normalised formulas also have release and trigger, the duals of until and since.
    """

    op: str
    lo: int
    hi: float
    left: Node
    right: Node


@dataclass(frozen=True)
class Step(Node):
    """One-step operator: next, prev (true outside the trace), s_next, s_prev (false outside), rise, fall."""

    op: str
    child: Node


@dataclass(frozen=True)
class Quantifier(Node):
    """``op variable in group: child``, an order statistic over one trailing axis of the child's values.

    Attributes:
        op: forall (the minimum), exists (the maximum) or at_least (the ``count``-th largest).
        variable: Name bound to a member of the group.
        group: Group of vehicles, such as ``others``.
        child: Quantified formula.
        depth: Number of enclosing quantifiers, which is also the trailing axis that is reduced.
        count: Required number of members, for at_least.
    """

    op: str
    variable: str
    group: str
    child: Node
    depth: int = 0
    count: int = 1


@dataclass(frozen=True)
class Slot(Node):
    """Placeholder for a sub-formula whose values are computed elsewhere; made by monitors."""

    index: int


def iter_parts(tree: Node | Term) -> Iterator[Node | Term]:
    """Yield the direct parts of a formula or term, left to right."""
    for value in vars(tree).values():
        for part in value if isinstance(value, tuple) else (value,):
            if isinstance(part, Node | Term):
                yield part


def children(node: Node) -> list[Node]:
    """Return the direct sub-formulas."""
    return [part for part in vars(node).values() if isinstance(part, Node)]


def walk(tree: Node | Term) -> Iterator[Node | Term]:
    """Yield the formula or term and everything below it, depth first."""
    yield tree
    for part in iter_parts(tree):
        yield from walk(part)


def rebuild(node: Node, change: Callable[[Node], Node]) -> Node:
    """Return the formula with ``change`` applied to its direct sub-formulas."""
    changed = {name: change(value) for name, value in vars(node).items() if isinstance(value, Node)}
    return dataclasses.replace(node, **changed) if changed else node


def signals(tree: Node | Term) -> tuple[str, ...]:
    """Return the names of the signals used, in order of appearance."""
    return tuple(dict.fromkeys(part.name for part in walk(tree) if isinstance(part, Signal)))


def is_signless(node: Node | Term) -> TypeGuard[Connective]:
    """Check for iff or xor, whose robustness has a sign that does not tell their truth."""
    return isinstance(node, Connective) and node.op in ("iff", "xor")


def nesting_depth(node: Node | Term) -> int:
    """Return how deeply the formula is nested; a signal counts 1."""
    return 1 + max((nesting_depth(part) for part in iter_parts(node)), default=0)


def _reach(node: Node, operators: frozenset[str], unbounded: Callable[[int], float]) -> float:
    # Nested bounds are added up; ``unbounded`` maps the lower bound of an unbounded operator.
    below = max((_reach(child, operators, unbounded) for child in children(node)), default=0)
    match node:
        case Window(op=op, lo=lo, hi=hi) | Until(op=op, lo=lo, hi=hi) if op in operators:
            return below + (unbounded(lo) if math.isinf(hi) else hi)
        case Step(op=op) if op in operators:
            return below + 1
    return below


def horizon(node: Node) -> float:
    """Return the samples that the formula looks ahead: nested future bounds added up, perhaps infinite."""
    return _reach(node, FUTURE, lambda lo: math.inf)


def history(node: Node) -> float:
    """Return the samples that the formula looks back: nested past bounds added up, perhaps infinite."""
    return _reach(node, PAST, lambda lo: math.inf)


def bounded_span(node: Node) -> int:
    """Return the samples that the bounded parts look ahead; an unbounded one counts its lower bound."""
    return int(_reach(node, FUTURE, lambda lo: lo))


def settling(node: Node) -> int:
    """Return the samples after which the formula is constant once its signals are.

    An unbounded past operator settles one sample after its operands.
    """
    return int(_reach(node, PAST, lambda lo: lo + 1))


def expand(node: Node) -> Node:
    """Expand a bare term, implies, unless or a one-step operator to the operators that define it."""
    match node:
        case Predicate(term):
            return Comparison(">", term, Number(0.0))
        case Connective("implies", left, right):
            return Connective("or", Not(left), right)
        case Step("rise", child):
            return Connective("and", Step("prev", Not(child)), child)
        case Step("fall", child):
            return Connective("and", Step("prev", child), Not(child))
        case Step(op, child):
            return Window(_STEPS[op], 1, 1, child)
        case Until("unless", lo, hi, left, right):
            return Connective("or", Window("always", 0, hi, left), Until("until", lo, hi, left, right))
    return node
