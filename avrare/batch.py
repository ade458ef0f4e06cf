"""Batched states: any nesting of dataclasses, dicts and tuples whose leaves are arrays with leading axis N.

``take`` copies particles, ``concatenate`` joins batches; that is all that splitting asks of a state.
None and plain Python scalars stand for themselves: they are shared by all particles.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

State = TypeVar("State")
_SHARED = (type(None), bool, int, float, str)


def map_leaves(function: Callable[..., Any], *states: Any) -> Any:
    """Apply ``function`` to the corresponding array leaves of states of the same structure.

    Raises:
        TypeError: A leaf is neither an array nor a shared scalar.
    """
    first = states[0]
    if isinstance(first, np.ndarray):
        return function(*states)
    if dataclasses.is_dataclass(first) and not isinstance(first, type):
        names = [field.name for field in dataclasses.fields(first)]
        leaves = {name: map_leaves(function, *(getattr(s, name) for s in states)) for name in names}
        return dataclasses.replace(first, **leaves)
    if isinstance(first, dict):
        return {key: map_leaves(function, *(s[key] for s in states)) for key in first}
    if isinstance(first, tuple):
        parts = [map_leaves(function, *group) for group in zip(*states, strict=True)]
        return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)
    if isinstance(first, _SHARED):
        return first
    raise TypeError(
        f"a state may hold arrays, dataclasses, dicts and tuples of them, not {type(first).__name__}"
    )


def take(state: State, index: NDArray[Any] | slice) -> State:
    """The particles ``index`` (integers, booleans or a slice) of a batch, in that order."""
    return map_leaves(lambda leaf: leaf[index], state)  # type: ignore[no-any-return]


def concatenate(states: Sequence[State]) -> State:
    """Join batches of the same structure along the particle axis."""
    if len(states) == 1:
        return states[0]
    return map_leaves(lambda *leaves: np.concatenate(leaves), *states)  # type: ignore[no-any-return]


def leaves(state: Any) -> list[NDArray[Any]]:
    """All array leaves of a state, in a fixed order."""
    found: list[NDArray[Any]] = []

    def collect(leaf: NDArray[Any]) -> NDArray[Any]:
        found.append(leaf)
        return leaf

    map_leaves(collect, state)
    return found


def size(state: Any) -> int:
    """The number of particles N of a batch.

    Raises:
        ValueError: The state holds no array, or its leaves disagree on N.
    """
    counts = {leaf.shape[0] if leaf.ndim else -1 for leaf in leaves(state)}
    if len(counts) != 1 or -1 in counts:
        raise ValueError(
            f"the arrays of a state must share one leading axis N, found lengths {sorted(counts)}"
        )
    return counts.pop()
