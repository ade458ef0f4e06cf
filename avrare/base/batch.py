"""Batched states: any nesting of dataclasses, dicts and tuples whose leaves are arrays with leading axis N.

``take`` copies particles, ``concatenate`` joins batches; splitting requires nothing else of a state.
None and scalars (Python's or NumPy's) are shared by all particles.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError

State = TypeVar("State")
_SHARED = (type(None), bool, int, float, str, np.generic)


def map_leaves(function: Callable[..., Any], *states: Any) -> Any:
    """Apply ``function`` to the corresponding array leaves of states of the same structure.

    Leaves that share one array in every state share one array in the result: a monitor's verdict is often
    part of its memory too.

    Raises:
        UsageError: A leaf is neither an array with a leading axis nor a shared scalar.
    """
    return _map(function, {}, states)


def _map(function: Callable[..., Any], done: dict[Any, Any] | None, states: Sequence[Any]) -> Any:
    # ``done``: results by the identities of their leaves; None: every leaf gets its own result.
    first = states[0]
    if isinstance(first, np.ndarray):
        if first.ndim == 0:
            raise UsageError("a state holds an array without axes", "give every array a leading axis N")
        if done is None:
            return function(*states)
        key = id(first) if len(states) == 1 else tuple(map(id, states))
        if key not in done:
            done[key] = function(*states)
        return done[key]
    if isinstance(first, dict):
        return {key: _map(function, done, [s[key] for s in states]) for key in first}
    if isinstance(first, tuple):
        parts = [_map(function, done, group) for group in zip(*states, strict=True)]
        return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)
    if isinstance(first, _SHARED):
        return first
    kind: Any = type(first)
    return kind(**{name: _map(function, done, [getattr(s, name) for s in states]) for name in _fields(kind)})


@functools.cache
def _fields(kind: type) -> tuple[str, ...]:
    if not dataclasses.is_dataclass(kind):
        raise UsageError(
            f"a state may hold arrays, dataclasses, dicts and tuples of them, not {kind.__name__}",
            "a batch is copied particle by particle: keep it in arrays with leading axis N",
        )
    return tuple(field.name for field in dataclasses.fields(kind))


def take(state: State, index: NDArray[Any] | slice) -> State:
    """Return the particles ``index`` (integers, booleans or a slice) of a batch, in that order."""
    return map_leaves(lambda leaf: leaf[index], state)  # type: ignore[no-any-return]


def concatenate(states: Sequence[State]) -> State:
    """Join batches of the same structure along the particle axis."""
    if len(states) == 1:
        return states[0]
    return map_leaves(lambda *leaves: np.concatenate(leaves), *states)  # type: ignore[no-any-return]


def separated(state: State) -> State:
    """Return a copy in which no two leaves are the same array."""
    return _map(np.copy, None, [state])  # type: ignore[no-any-return]


def leaves(state: Any) -> list[NDArray[Any]]:
    """Return all array leaves of a state, in a fixed order."""
    found: list[NDArray[Any]] = []

    def collect(leaf: NDArray[Any]) -> NDArray[Any]:
        found.append(leaf)
        return leaf

    _map(collect, None, [state])
    return found


def size(state: Any) -> int:
    """Return the number of particles N of a batch, on which all its arrays must agree."""
    counts = {len(leaf) for leaf in leaves(state)}
    if len(counts) != 1:
        raise UsageError(
            f"the arrays of a state must share one leading axis N, found lengths {sorted(counts)}"
        )
    return counts.pop()
