"""Why a formula has the robustness that it has: which sample, which vehicle, which comparison decide it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.errors import FormulaError
from avrare.logic import formula as f
from avrare.logic.algebra import TINY
from avrare.logic.causes import Part, Place, Values
from avrare.logic.printing import text


@dataclass(frozen=True)
class Link:
    """One step down from a formula to what decides it.

    Attributes:
        text: The sub-formula, its bound vehicles by name.
        sample: Where it is looked at.
        value: Its robustness there.
    """

    text: str
    sample: int
    value: float


@dataclass(frozen=True)
class Cause:
    """A way down from a formula to what decides it.

    Attributes:
        sample: Where the outermost temporal operator's operand decides.
        bindings: variable -> member's name, or its index where the group's members have no names.
        chain: From the formula down.
    """

    sample: int
    bindings: dict[str, str | int]
    chain: tuple[Link, ...]


@dataclass(frozen=True)
class Explanation:
    """What decides a formula at sample 0 of one trace.

    Attributes:
        robustness: Of the formula.
        violated: It is false.
        first: The sample of the earliest cause: for a broken ``always``, the first at which its operand is
            false.
        worst: The sample that decides the robustness: for ``always``, where its operand is smallest.
        bindings: variable -> member, for the quantifiers on the way to the worst.
        formula: The sub-formula that decides the robustness, its bound vehicles by name.
        value: Its robustness.
        chain: From the whole formula down to it.
        earliest: The way down to the earliest cause, which may be another vehicle's.
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


def explain(node: f.Node, values: Values) -> Explanation:
    """The explanation of a formula from the values of its sub-formulas."""
    root = Place(node, 0)
    worst, earliest = _walk(root, values, early=False), _walk(root, values, early=True)
    last = worst.chain[-1]
    return Explanation(
        robustness=worst.chain[0].value,
        violated=root.pick(values.truths[node]) < 0,
        first=earliest.sample,
        worst=worst.sample,
        bindings=worst.bindings,
        formula=last.text,
        value=last.value,
        chain=worst.chain,
        earliest=earliest,
    )


def _walk(place: Place, values: Values, early: bool) -> Cause:
    """Down to what decides; ``early``: where one part is enough, to the first of them."""
    value = place.pick(values.margins[place.node])
    labels = {binding.variable: binding.label for binding in place.bindings}
    link = Link(text(_named(place.node, labels)), place.sample, 0.0 if abs(value) <= TINY else value)
    found = values.parts(place)
    if not found.parts:
        bindings = {b.variable: b.index if b.name is None else b.name for b in place.bindings}
        return Cause(place.sample, bindings, (link,))
    temporal = isinstance(place.node, f.Window | f.Until | f.Step) and place.node.op != "unless"
    enough = found.sufficient() if early else []
    if enough and temporal:
        enough = [min(enough, key=_sample)]
    ways = [_step(part, values, early, temporal) for part in enough or [found.decisive()]]
    way = min(ways, key=lambda cause: cause.sample)
    return dataclasses.replace(way, chain=(link, *way.chain))


def _step(part: Part, values: Values, early: bool, temporal: bool) -> Cause:
    cause = _walk(part.place, values, early)
    return dataclasses.replace(cause, sample=part.place.sample) if temporal else cause


def _sample(part: Part) -> int:
    return part.place.sample


def _named(item: Any, labels: Mapping[str, str]) -> Any:
    """The formula with its bound vehicles by name."""
    if isinstance(item, f.Signal):
        return dataclasses.replace(item, arguments=tuple(labels.get(word, word) for word in item.arguments))
    if isinstance(item, tuple):
        return tuple(_named(part, labels) for part in item)
    if not isinstance(item, f.Node | f.Term):
        return item
    changed = {field.name: _named(getattr(item, field.name), labels) for field in dataclasses.fields(item)}
    return dataclasses.replace(item, **changed)


def one_trace(signals: Mapping[str, Any], node: f.Node) -> Mapping[str, Any]:
    """The signals of one trace, (1, T, ...) each; unfit ones are left for others to refuse.

    Args:
        signals: (T, ...) or (1, T, ...) each.
        node: The formula, whose relations tell how many axes a sample has.

    Raises:
        FormulaError: There are several traces.
    """
    names: Sequence[str] = f.signals(node) or list(signals)[:1]
    arrays = {name: signals[name] for name in names if isinstance(signals.get(name), np.ndarray)}
    axes = {
        part.name: len(part.axes) for part in f.walk(node) if isinstance(part, f.Signal) and part.arguments
    }
    lead = {arrays[name].ndim - count for name, count in axes.items() if name in arrays}
    lead |= {1 for x in arrays.values() if x.ndim == 1}
    several = any(isinstance(part, f.Quantifier) for part in f.walk(node))
    batched = min(lead) > 1 if lead else not several or all(len(x) == 1 for x in arrays.values())
    if batched and any(len(x) != 1 for x in arrays.values()):
        raise FormulaError("only one trace is explained at a time", "give signals (T,), relations (T, V)")
    return {**signals, **{name: x if batched else x[None] for name, x in arrays.items()}}
