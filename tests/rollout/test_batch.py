"""Batches of particles."""

import numpy as np
import pytest

import odd_systems
from avrare.base import batch
from avrare.base.errors import UsageError

X = np.arange(5.0)
STATE = odd_systems.Nested(odd_systems.Inner(X), (X + 1, np.stack([X, -X], axis=1)))


def test_take_and_concatenate():
    picked = batch.take(STATE, np.array([3, 0, 3]))
    assert picked.inner.x.tolist() == [3, 0, 3]
    assert picked.pair[1].tolist() == [[3, -3], [0, 0], [3, -3]]
    assert (picked.label, picked.nothing) == ("car", None)
    halves = [batch.take(STATE, slice(0, 2)), batch.take(STATE, np.arange(5) >= 2)]
    for joined, whole in zip(batch.leaves(batch.concatenate(halves)), batch.leaves(STATE), strict=True):
        np.testing.assert_array_equal(joined, whole)


def test_size():
    assert batch.size(STATE) == 5
    for odd in ({"a": X, "b": X[1:]}, {"a": None}):
        with pytest.raises(UsageError, match="leading axis"):
            batch.size(odd)


def test_copies_are_copies():
    picked = batch.take(STATE, np.array([1, 1]))
    picked.inner.x[0] = 9.0
    assert picked.inner.x[1] == 1.0
    assert STATE.inner.x[1] == 1.0


def test_every_container():
    state = {"a": X, "b": odd_systems.Point(X), "c": [None, 1, 2.5, "s", True, np.int64(3)][-1], "d": ()}
    picked = batch.take(state, slice(1, 3))
    assert picked["b"] == odd_systems.Point(picked["b"].x)
    assert isinstance(picked["b"], odd_systems.Point)
    assert picked["c"] == 3
    assert [leaf.tolist() for leaf in batch.leaves(picked)] == [[1, 2], [1, 2]]


@pytest.mark.parametrize("state", [[X], {"a": {X.size}}, {"a": np.array(1.0)}, object(), odd_systems.Inner])
def test_unsupported_values_in_a_state(state):
    with pytest.raises(UsageError, match="state"):
        batch.take(state, slice(0, 1))


def test_an_array_in_two_places_stays_shared():
    x = np.arange(4.0)
    shared, apart = {"a": x, "b": x}, {"a": x, "b": x.copy()}
    picked = batch.take(shared, np.array([1, 2]))
    assert picked["a"] is picked["b"]
    both = batch.concatenate([shared, shared])
    assert both["a"] is both["b"]
    mixed = batch.concatenate([shared, apart])
    assert mixed["a"] is not mixed["b"]
    assert mixed["b"].tolist() == [*x, *x]
    copy = batch.separate_leaves(shared)
    assert copy["a"] is not copy["b"]
    assert copy["a"] is not x
    assert copy["b"].tolist() == x.tolist()
