"""Leaps: failures that one outlier decides are told apart from those that splitting can climb to."""

import numpy as np
import pytest

import avrare
from avrare.testing.problems import reference_problem
from avrare_estimators.ams.leaps import Leaps
from plain_systems import Largest

OUTLIER = avrare.Problem(Largest(), avrare.stl("always (x < 4)"), 10)  # every step begins anew


def rising(leaps, others):
    """Return scores of 1,000 rollouts, the best of which leap at the last step, or come by way of others."""
    scores = np.repeat(np.arange(1000.0)[:, None], 3, axis=1)
    best = 1000 - leaps - others
    scores[best : best + leaps, :2] = 500.0
    scores[best + leaps :, :2] = 950.0
    return scores


def told(leaps):
    return leaps.count, leaps.rows


def test_leaps_are_counted():
    # 10 pass the level of 1 %, of which the last 4 came there by way of more than 10 %.
    assert told(Leaps.of(rising(6, 4))) == (6, 10)


def test_levels_are_those_of_all_batches_together():
    scores = np.concatenate([rising(6, 4), rising(3, 7), 2.0 * rising(9, 1), rising(0, 10)])
    shuffled = np.random.default_rng(0).permutation(scores)
    whole = told(Leaps.of(scores))
    assert 0 < whole[0] < whole[1] == 40
    for count in (2, 3, 16):
        parts = (Leaps.of(part) for part in np.array_split(shuffled, count))
        assert told(sum(parts, Leaps())) == whole


def tells_of_leaps(result):
    """Return whether a warning, or a note where target rows answer it, is of leaps."""
    texts = [*result.health.values(), *(note.text for note in result.notes if note.kind == "doubt")]
    return any("splitting cannot climb" in text for text in texts)


@pytest.mark.parametrize("seed", range(3))
def test_splitting_warns_of_what_it_cannot_climb_to(seed):
    result = avrare.estimate(OUTLIER, "ams", seed=seed, runs=20, particles=100, discard=10)
    assert tells_of_leaps(result)
    assert result.interval[1] >= result.fresh.interval(0.95)[1]


@pytest.mark.parametrize("name", ["d_rw_L3.8", "e_ou_L4.0"])
def test_what_can_be_climbed_to_is_not_warned_of(name):
    problem = reference_problem(name).problem()
    for seed in range(3):
        result = avrare.estimate(problem, "ams", seed=seed, runs=25, particles=100, discard=10)
        assert not tells_of_leaps(result)


def test_warnings_do_not_depend_on_batches_of_runs():
    options = {"seed": 1, "runs": 40, "particles": 200, "discard": 20, "grow": False}
    whole, parts = (avrare.estimate(OUTLIER, "ams", memory=memory, **options) for memory in (None, 1))
    assert "leaps" in whole.health
    assert parts.health == whole.health
