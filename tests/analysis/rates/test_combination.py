"""Intervals of rates: exact cases, and what each kind of uncertainty adds."""

import math

import numpy as np
import pytest
from scipy import stats

from avrare.analysis.rates.allocation import LEAST, allocate
from avrare.analysis.rates.combination import (
    Quantity,
    combine,
    from_blocks,
    from_count,
    from_exposure,
    from_interval,
    from_rollouts,
)
from avrare.base.errors import UsageError
from avrare.scenario.exposure import Exposure


def known(value):
    return Quantity(value, value, value)


def test_one_scene_of_known_exposure_has_the_interval_of_its_probability():
    p = from_rollouts(12, 400, 0, 0.95, False)
    total = combine([known(3.0)], [p])
    assert total.value == pytest.approx(0.09)
    assert total.interval == pytest.approx((3.0 * p.low, 3.0 * p.high))
    assert total.sampling == total.interval
    assert total.exposure == (pytest.approx(0.09), pytest.approx(0.09))


def test_jeffreys_intervals_are_those_of_scipy():
    p = from_rollouts(12, 400, 0, 0.9, False)
    assert (p.low, p.high) == pytest.approx(stats.beta.interval(0.9, 12.5, 388.5))
    e = from_count(7, 20.0, 0.9)
    assert (e.low, e.high) == pytest.approx(tuple(x / 20.0 for x in stats.gamma.interval(0.9, 7.5)))
    assert (from_rollouts(0, 50, 0, 0.95, False).low, from_count(0, 9.0, 0.95).low) == (0.0, 0.0)
    assert from_rollouts(3, 100, 2, 0.95, True).high == pytest.approx(stats.beta.ppf(0.975, 6, 95))


def test_a_given_interval_is_brought_to_the_level_asked_for():
    same = from_interval(3.0, (2.0, 4.5), 0.95, 0.95)
    assert (same.low, same.high) == pytest.approx((2.0, 4.5))
    wider = from_interval(3.0, (2.0, 4.5), 0.6826894921, 0.9544997361)  # one and two standard deviations
    assert (wider.low, wider.high) == pytest.approx((3.0 * (2 / 3) ** 2, 3.0 * 1.5**2))


def test_independent_parts_add_in_squares():
    scenes = [(known(2.0), Quantity(0.1, 0.08, 0.13)), (known(5.0), Quantity(0.02, 0.01, 0.04))]
    total = combine(*zip(*scenes, strict=True))
    assert total.value == pytest.approx(0.3)
    assert total.interval[0] == pytest.approx(0.3 - math.hypot(2 * 0.02, 5 * 0.01))
    assert total.interval[1] == pytest.approx(0.3 + math.hypot(2 * 0.03, 5 * 0.02))
    assert total.shares == pytest.approx((2 / 3, 1 / 3))
    assert sum(total.doubts) == pytest.approx(1.0)


def test_without_a_failure_the_rate_reaches_up_and_not_down():
    total = combine([Quantity(2.0, 1.5, 2.6)], [from_rollouts(0, 100, 0, 0.95, True)])
    assert total.value == total.interval[0] == 0.0
    assert total.interval[1] > total.sampling[1] > 0.0
    assert total.exposure == (0.0, 0.0)
    assert total.shares == (0.0,)


def test_the_budget_goes_where_the_variance_is():
    pilot = [[(10, 100)], [(10, 100)], [(0, 100)]]
    counts = allocate([1.0, 4.0, 1.0], pilot, [1.0] * 3, 6000)
    assert sum(counts) in range(5990, 6001)
    assert counts[1] == pytest.approx(4 * counts[0], rel=0.01)
    assert LEAST < counts[2] < counts[0]


def test_a_scene_of_no_account_still_gets_the_least():
    counts = allocate([100.0, 1e-6], [[(10, 100)], [(0, 100)]], [1.0, 1.0], 1000)
    assert counts == [980, LEAST]
    with pytest.raises(UsageError, match="does not pay for 20 rollouts"):
        allocate([1.0, 1.0], [[(1, 100)], [(1, 100)]], [1.0, 1.0], 39)


def test_neyman_s_shares_have_the_least_variance():
    e, p = np.array([3.0, 1.0, 0.2]), np.array([0.05, 0.2, 0.5])
    pilot = [[(round(1e6 * q), 10**6)] for q in p]

    def variance(counts):
        return float((e**2 * p * (1 - p) / np.array(counts)).sum())

    best = allocate(e.tolist(), pilot, [1.0] * 3, 3000)
    rng = np.random.default_rng(0)
    others = rng.dirichlet(np.ones(3), 200) * 3000
    assert variance(best) <= min(map(variance, others)) * 1.001
    assert variance(best) < variance([1000] * 3)


def test_counts_by_block_have_the_interval_of_their_scatter():
    rng = np.random.default_rng(1)
    for scatter, blocks, least in ((1.0, 63, 0.94), (3.6, 63, 0.93), (3.6, 12, 0.92)):
        covered = 0
        for _ in range(1000):
            law = rng.gamma(4.7 / (scatter - 1.0), scatter - 1.0, blocks) if scatter > 1.0 else 4.7
            rate = from_blocks([int(x) for x in rng.poisson(law, blocks)], 1.0, 0.95)
            covered += rate.low <= 4.7 <= rate.high
        assert covered / 1000 > least


def test_blocks_without_scatter_count_as_poisson_and_few_blocks_widen():
    even = from_exposure(Exposure(counts=[5] * 60, km=100.0), 0.95)
    poisson = from_count(300, 6000.0, 0.95)
    assert Exposure(counts=[5] * 60, km=100.0).total == 300
    assert even.value == poisson.value == 0.05
    assert 1.0 < (even.high - even.low) / (poisson.high - poisson.low) < 1.05
    assert from_blocks([0, 0, 0], 2.0, 0.95) == from_count(0, 6.0, 0.95)
    assert from_blocks([5, 5], 1.0, 0.95).low < from_count(10, 2.0, 0.95).low
