"""Particles discarded at a level, and the steps at which their successors branch."""

import numpy as np
import pytest

from avrare_estimators.ams.levels import choose_parents, first_above, next_level


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
