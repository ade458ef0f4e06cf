import numpy as np

from avrare_estimators.common.chains.levels import choose_seeds, effective_samples, next_levels, r_hat


def _next(values, survivors):
    level, more = next_levels(np.array([values], dtype=float), survivors)
    return float(level[0]), bool(more[0])


def test_level_is_the_largest_score_that_does_not_survive():
    assert _next([3, 1, 4, 2, 5], 2) == (3.0, True)


def test_a_level_at_the_lowest_score_discards_all_of_its_ties():
    assert _next([1, 1, 1, 1, 2], 2) == (1.0, True)


def test_no_level_where_all_are_tied_or_enough_have_failed():
    assert not _next([2, 2, 2, 2], 2)[1]
    assert not _next([1, 2, np.inf, np.inf], 2)[1]
    assert _next([1, 2, 3, np.inf], 2) == (2.0, True)


def test_broken_rollouts_are_below_every_level():
    level, more = _next([-np.inf, -np.inf, -np.inf, 1.0], 2)
    assert (level, more) == (-np.inf, True)
    assert not _next([-np.inf, -np.inf], 1)[1]


def test_seeds_are_survivors_chosen_equally_often_on_average():
    rng = np.random.default_rng(0)
    alive = np.tile([True, False, True, True, False, True, True], (4000, 1))
    chosen = choose_seeds(alive, 3, rng.uniform(size=4000))
    assert np.take_along_axis(alive, chosen, axis=1).all()
    count = np.bincount(chosen.ravel(), minlength=7)[alive[0]] / 4000
    assert np.abs(count - 3 / 5).max() < 4 * np.sqrt(0.24 / 4000)
    assert all(len(set(row)) == 3 for row in chosen[:100].tolist()), "none twice while there are enough"


def test_effective_size_detects_chains_that_stand_still():
    rng = np.random.default_rng(1)
    independent = rng.uniform(size=(50, 10, 200)) < 0.3
    still = np.repeat(rng.uniform(size=(50, 1, 200)) < 0.3, 10, axis=1)
    assert abs(effective_samples(independent).mean() / 2000 - 1) < 0.1
    assert abs(effective_samples(still).mean() / 200 - 1) < 0.1
    assert effective_samples(np.ones((1, 4, 5), dtype=bool)).tolist() == [20.0]


def test_r_hat_is_one_for_independent_samples_only():
    rng = np.random.default_rng(2)
    values = rng.normal(size=(3, 10, 400))
    assert np.abs(r_hat(values) - 1.0).max() < 0.03
    assert (r_hat(values + 2.0 * rng.normal(size=(3, 1, 400))) > 1.5).all()
    assert r_hat(np.zeros((1, 5, 4))).tolist() == [1.0]
    assert np.isinf(r_hat(np.tile(np.arange(4.0), (1, 5, 1)))).all()
