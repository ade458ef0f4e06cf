"""Robustness of a formula's predicates over time, for the vehicles that decide it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from avrare.errors import FormulaError
from avrare.logic import formula as f
from avrare.logic.api import Formula
from avrare.logic.printing import text
from avrare.protocols import Floats
from avrare.record.trace_score import Score


@dataclass(frozen=True)
class Part:
    """A predicate along a drive.

    Attributes:
        text: With the vehicles' names.
        values: (T,) its robustness.
    """

    text: str
    values: Floats


def predicates(specification: Any, score: Score) -> list[Part]:
    """The predicates of a specification, in the order in which they are written; none without a formula.

    A variable stands for the vehicle that decides; where none does, there is a part for each vehicle.
    """
    formula: Formula | None = getattr(specification, "formula", None)
    if formula is None:
        return []
    sample = getattr(specification, "sample", None)
    signals = score.recording.signals if sample is None else sample(score.recording.signals)
    try:
        values = formula.parts({key: np.asarray(x)[None] for key, x in signals.items()})
    except FormulaError:
        return []
    names = tuple(getattr(specification, "names", score.recording.names))
    moment = score.first or score.worst
    chosen = moment.vehicles if moment is not None else {}
    found: dict[str, Floats] = {}
    for node, quantifiers in _leaves(formula.node, ()):
        array = values[text(node)][0]
        for words, row in _rows(text(node), array, quantifiers, names, chosen):
            found.setdefault(words, row)
    return [Part(words, row) for words, row in found.items()]


def _leaves(
    node: f.Node, around: tuple[f.Quantifier, ...]
) -> Iterator[tuple[f.Node, tuple[f.Quantifier, ...]]]:
    """The predicates, each with the quantifiers around it."""
    inner = (*around, node) if isinstance(node, f.Quantifier) else around
    below = f.children(node)
    if not below:
        yield node, around
    for child in below:
        yield from _leaves(child, inner)


def _rows(
    words: str, array: Floats, quantifiers: Sequence[f.Quantifier], names: Sequence[str],
    chosen: Mapping[str, str],
) -> Iterator[tuple[str, Floats]]:  # fmt: skip
    """The predicate for each choice of vehicles, (T,) each."""
    sizes = array.shape[1:]
    axes = []
    for quantifier, size in zip(quantifiers, sizes, strict=False):
        label = chosen.get(quantifier.variable)
        members = list(names) if len(names) == size else [str(k) for k in range(size)]
        one = [members.index(label)] if label in members and size > 1 else range(size)
        axes.append([(quantifier.variable, members[k] if size > 1 else None, k) for k in one])
    for choice in product(*axes):
        called = {variable: member for variable, member, _ in choice if member is not None}
        said = re.sub(r"\b[A-Za-z_]\w*\b", lambda word, called=called: called.get(word[0], word[0]), words)  # type: ignore[misc]
        yield said, np.moveaxis(array, 0, -1)[tuple(k for _, _, k in choice)]
