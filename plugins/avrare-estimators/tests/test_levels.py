"""Particles discarded at a level, the steps at which successors branch, and what is kept of particles."""

import numpy as np
import pytest

from avrare.protocols import Verdict
from avrare.rollout.request import Carry
from avrare_estimators.ams.levels import choose_parents, first_above, next_level
from avrare_estimators.ams.population import Population


def level(score, violated, discard):
    found = next_level(np.array([score], dtype=float), np.array([violated], dtype=bool), discard)
    return found.score[0], bool(found.reached[0]), found.discarded[0].tolist()


@pytest.mark.parametrize(
    ("score", "violated", "discard", "expected"),
    [
        ([3, 1, 2, 4], [0, 0, 0, 1], 1, (1, False, [0, 1, 0, 0])),
        ([3, 1, 2, 4], [0, 0, 0, 1], 2, (2, False, [0, 1, 1, 0])),
        ([2, 1, 2, 2], [0, 0, 0, 0], 2, (2, False, [1, 1, 1, 1])),  # ties go together: extinct
        ([2, 1, 2, 2], [0, 0, 1, 0], 2, (2, False, [1, 1, 0, 1])),  # a failure lies above its score
        ([2, 1, 2, 2], [1, 0, 1, 1], 2, (2, True, [0, 1, 0, 0])),  # the K-th is a failure: done
        ([0, 0, 0, 0], [1, 1, 1, 1], 3, (0, True, [0, 0, 0, 0])),
        ([5, 1, 2, 3], [0, 1, 0, 0], 2, (2, False, [0, 1, 1, 0])),  # a failure of low score goes too
        ([-np.inf, 1, 2, 3], [0, 0, 0, 0], 1, (-np.inf, False, [1, 0, 0, 0])),
        ([np.inf, np.inf, np.inf], [0, 1, 0], 1, (np.inf, False, [1, 0, 1])),
    ],
)
def test_next_level(score, violated, discard, expected):
    assert level(score, violated, discard) == (expected[0], expected[1], [bool(x) for x in expected[2]])


def test_every_run_has_a_level_of_its_own():
    scores = np.random.default_rng(0).normal(size=(5, 20))
    found = next_level(scores, np.zeros((5, 20), dtype=bool), 4)
    np.testing.assert_array_equal(found.score, np.sort(scores, axis=1)[:, 3])
    assert (found.discarded.sum(axis=1) == 4).all()


def test_first_above_is_strict():
    scores = np.array([[0, 1, 1, 3], [0, 1, 2, 2], [1, 1, 1, 1], [2, 2, 2, 2.0]])
    assert first_above(scores, np.array([1.0, 1.0, 1.0, 1.0])).tolist() == [3, 2, 3, 0]


def test_parents_are_uniform_among_the_eligible_of_their_run():
    eligible = np.array([[True, False, True, False], [False, False, False, True], [True] * 4])
    runs = np.repeat([0, 1, 2], 6000)
    uniforms = np.tile((np.arange(6000) + 0.5) / 6000, 3)
    parents = choose_parents(eligible, runs, uniforms)
    counts = np.bincount(parents, minlength=12).reshape(3, 4)
    assert counts.tolist() == [[3000, 0, 3000, 0], [0, 0, 0, 6000], [1500] * 4]
    assert choose_parents(eligible, np.array([2]), np.array([np.nextafter(1.0, 0.0)])).tolist() == [11]


def carry(x, score):
    """Return a carry whose monitor state is ``score``; the same array as its verdict's score, or another."""
    return Carry({"x": x}, (x,), (Verdict(-score, score > 9.0, score),))


@pytest.mark.parametrize("first_shared", [True, False])
@pytest.mark.parametrize("then_shared", [True, False])
def test_carries_are_stored_correctly_when_leaves_share_an_array(first_shared, then_shared):
    def given(values, shared):
        x = np.asarray(values, dtype=np.float64)
        return carry(x, x if shared else 10.0 * x)

    population = Population.empty(5, 5, 3)
    population.store_carry(2, np.arange(5), given([0, 1, 2, 3, 4], first_shared))
    population.store_carry(2, np.array([3, 1]), given([30, 10], then_shared))
    slots = np.array([1, 2, 3])
    ((step, kept),) = population.branch(slots, np.array([2, 2, 2]))
    assert step == 2
    assert kept.system["x"].tolist() == kept.monitors[0].tolist() == [10, 2, 30]
    old, new = (1 if first_shared else 10), (1 if then_shared else 10)
    assert kept.verdicts[0].score.tolist() == [10 * new, 2 * old, 30 * new]
