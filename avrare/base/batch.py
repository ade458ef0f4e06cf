"""Batched states: any nesting of dataclasses, dicts and tuples whose leaves are arrays with leading axis N.

``take`` copies particles, ``concatenate`` joins batches; splitting requires nothing else of a state.
None and scalars (Python's or NumPy's) are shared by all particles.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError

State = TypeVar("State")
_SHARED = (type(None), bool, int, float, str, np.generic)
_NO_AXES = ("a state holds an array without axes", "give every array a leading axis N")


def map_leaves(function: Callable[..., object], *states: State) -> State:
    """Apply ``function`` to the corresponding array leaves of states of the same structure.

    Leaves that share one array in every state share one array in the result: a monitor's verdict is often
    part of its memory too.

    Raises:
        UsageError: A leaf is neither an array with a leading axis nor a shared scalar.
    """
    return _map(function, {}, [states])[0]


def _map(
    function: Callable[..., object],
    done: dict[tuple[int, ...], object] | None,
    groups: Iterable[Sequence[State]],
) -> list[State]:
    # ``groups``: the corresponding parts of all states. ``done``: results by the identities of their leaves;
    # None: every leaf gets its own result. Splitting does this at every step: there is no call for a leaf.
    results: list[Any] = []
    for group in groups:
        first = group[0]
        kind: Any = type(first)
        if isinstance(first, np.ndarray):
            if first.ndim == 0:
                raise UsageError(*_NO_AXES)
            key = tuple(map(id, group))
            if done is None:
                results.append(function(*group))
            elif key in done:
                results.append(done[key])
            else:
                results.append(done.setdefault(key, function(*group)))
        elif isinstance(first, tuple):
            parts = _map(function, done, zip(*group, strict=True))
            results.append(kind(*parts) if hasattr(kind, "_fields") else tuple(parts))
        elif isinstance(first, dict):
            mappings: Sequence[Any] = group
            parts = _map(function, done, [[part[key] for part in mappings] for key in first])
            results.append(dict(zip(first, parts, strict=True)))
        elif isinstance(first, _SHARED):
            results.append(first)
        else:
            names, values = _fields(kind)
            parts = _map(function, done, zip(*map(values, group), strict=True))
            results.append(kind(**dict(zip(names, parts, strict=True))))
    return results


@functools.cache
def _fields(kind: type) -> tuple[tuple[str, ...], Callable[[object], tuple[object, ...]]]:
    """Return the names of a dataclass's fields, and the function from an instance to their values."""
    if not dataclasses.is_dataclass(kind):
        raise UsageError(
            f"a state may hold arrays, dataclasses, dicts and tuples of them, not {kind.__name__}",
            "a batch is copied particle by particle: keep it in arrays with leading axis N",
        )
    names = tuple(field.name for field in dataclasses.fields(kind))
    if len(names) < 2:  # of a single name ``attrgetter`` makes no tuple
        return names, lambda state: tuple(getattr(state, name) for name in names)
    return names, operator.attrgetter(*names)


def take(state: State, index: NDArray[np.generic] | slice) -> State:
    """Return the particles ``index`` (integers, booleans or a slice) of a batch, in that order."""
    return map_leaves(lambda leaf: leaf[index], state)


def concatenate(states: Sequence[State]) -> State:
    """Join batches of the same structure along the particle axis."""
    if len(states) == 1:
        return states[0]
    return map_leaves(lambda *leaves: np.concatenate(leaves), *states)


def choose(rows: NDArray[np.bool_], first: State, second: State) -> State:
    """Return a batch with the particles of ``first`` where ``rows`` (N,) is True, of ``second`` elsewhere."""

    def pick(chosen: NDArray[np.generic], other: NDArray[np.generic]) -> NDArray[np.generic]:
        return np.where(rows.reshape(-1, *[1] * (other.ndim - 1)), chosen, other)

    return map_leaves(pick, first, second)


def separate_leaves(state: State) -> State:
    """Return a copy in which no two leaves are the same array."""
    return _map(np.copy, None, [[state]])[0]


def leaves(state: object) -> list[NDArray[np.generic]]:
    """Return all array leaves of a state, in a fixed order."""
    arrays: list[NDArray[np.generic]] = []
    _collect((state,), arrays)
    return arrays


def _collect(parts: Iterable[object], arrays: list[NDArray[np.generic]]) -> None:
    # No call for a leaf, and nothing is built: splitting does this at every step of every stage.
    for part in parts:
        if isinstance(part, np.ndarray):
            if part.ndim == 0:
                raise UsageError(*_NO_AXES)
            arrays.append(part)
        elif isinstance(part, tuple):
            _collect(part, arrays)
        elif isinstance(part, dict):
            _collect(part.values(), arrays)
        elif not isinstance(part, _SHARED):
            kind: Any = type(part)
            _collect(_fields(kind)[1](part), arrays)


def size(state: object) -> int:
    """Return the number of particles N of a batch, on which all its arrays must agree."""
    counts = {len(leaf) for leaf in leaves(state)}
    if len(counts) != 1:
        raise UsageError(
            f"the arrays of a state must share one leading axis N, found lengths {sorted(counts)}"
        )
    return counts.pop()
