"""A part of a formula for chosen vehicles: closed, so that it can be explained by itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic import formula as f

Inputs = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Bound:
    """A formula without free variables, and what it reads.

    Attributes:
        node: The formula.
        inputs: (1, T, ...).
    """

    node: f.Node
    inputs: Inputs


def bind(node: f.Node, chosen: Mapping[str, tuple[str, int]], inputs: Inputs) -> Bound:
    """A part of a formula for one vehicle each of the quantifiers around it.

    Args:
        node: The part.
        chosen: Variable of every quantifier around it, outermost first -> name and index of its vehicle.
        inputs: What the formula reads, (1, T, ...), the trailing axes vehicles.
    """
    indices = [index for _, index in chosen.values()]
    names = {variable: name for variable, (name, _) in chosen.items()}
    found: dict[str, NDArray[Any]] = {}

    def signal(item: f.Signal) -> f.Signal:
        values = inputs[item.name]
        depths = item.axes if item.arguments else tuple(range(values.ndim - 2))
        for axis in reversed(range(len(depths))):
            if depths[axis] < len(indices):
                only = values.shape[2 + axis] == 1
                values = np.take(values, 0 if only else indices[depths[axis]], axis=2 + axis)
        arguments = tuple(names.get(word, word) for word in item.arguments)
        key = f"{item.name} of {', '.join(arguments)}" if arguments else item.name
        found[key] = values
        axes = tuple(depth - len(indices) for depth in item.axes if depth >= len(indices))
        return f.Signal(key, arguments, axes)

    def change(item: Any) -> Any:
        if isinstance(item, f.Signal):
            return signal(item)
        if isinstance(item, tuple):
            return tuple(map(change, item))
        if not isinstance(item, f.Node | f.Term):
            return item
        parts = {field.name: change(getattr(item, field.name)) for field in dataclasses.fields(item)}
        if isinstance(item, f.Quantifier):
            parts["depth"] = item.depth - len(indices)
        return type(item)(**parts)

    return Bound(change(node), found or dict(inputs))


def consequence(node: f.Node) -> tuple[Sequence[f.Quantifier], f.Node] | None:
    """C of ``forall o in others: A -> C``, below the quantifiers around it; None for another shape."""
    outer = []
    while isinstance(node, f.Quantifier) and node.op == "forall":
        outer.append(node)
        node = node.child
    if not isinstance(node, f.Connective) or node.op != "implies":
        return None
    while isinstance(node, f.Connective) and node.op == "implies":
        node = node.right
    return outer, node
