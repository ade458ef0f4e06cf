"""Ratios of two estimates against exact and asymptotic tests."""

import math
from statistics import NormalDist

import pytest

from avrare.analysis.check.melded_intervals import (
    p_value_ratio_at_least,
    p_value_ratio_at_most,
    ratio_interval,
)
from avrare.estimation.result import intervals
from avrare.estimation.result.confidence_distributions import Binomial, LogNormal, Tabulated

TABLES = [(12, 1000, 1, 1000), (7, 500, 0, 1000), (0, 100, 3, 200), (90, 4000, 45, 4000), (5, 5, 2, 5),
          (3, 7, 0, 9), (20, 80, 9, 90), (0, 50, 0, 70), (30, 30, 30, 30)]  # fmt: skip


@pytest.mark.parametrize("table", TABLES)
def test_two_binomials_are_compared_by_fishers_exact_test(table):
    from scipy.stats import fisher_exact as fisher

    failed, trials, before, trials_before = table
    counts = [[failed, trials - failed], [before, trials_before - before]]
    new, old = Binomial(failed, trials), Binomial(before, trials_before)
    assert p_value_ratio_at_most(1.0, new, old) == pytest.approx(
        fisher(counts, alternative="greater")[1], rel=0.02, abs=1e-6
    )
    assert p_value_ratio_at_least(1.0, new, old) == pytest.approx(
        fisher(counts, alternative="less")[1], rel=0.02, abs=1e-6
    )


@pytest.mark.parametrize("ratio", [1.0, 1.5, 3.0])
def test_two_log_normals_are_compared_by_their_logarithms(ratio):
    new, old = LogNormal(2e-3, 0.02, 0), LogNormal(1e-3, 0.03, 0)
    error = math.sqrt(math.log1p(0.02) + math.log1p(0.03))
    below = NormalDist().cdf((math.log(ratio) - math.log(2.0)) / error)
    assert p_value_ratio_at_most(ratio, new, old) == pytest.approx(below, rel=0.01)
    assert p_value_ratio_at_least(ratio, new, old) == pytest.approx(1 - below, rel=0.01)


@pytest.mark.parametrize("other", [Binomial(3, 100), LogNormal(1e-3, 0.1, 9)], ids=str)
def test_an_uninformative_estimate_decides_nothing(other):
    nothing = Tabulated.from_intervals(intervals.unknown)
    for one, two in ((nothing, other), (other, nothing)):
        assert p_value_ratio_at_most(1.0, one, two) == pytest.approx(1.0)
        assert p_value_ratio_at_least(2.0, one, two) == pytest.approx(1.0)
    assert ratio_interval(0.95, nothing, other) == (0.0, math.inf)


def test_errors_count_against_every_hypothesis():
    new, old = Binomial(60, 4000), Binomial(30, 4000)
    assert p_value_ratio_at_most(1.0, new, Binomial(30, 4000, 10)) > p_value_ratio_at_most(1.0, new, old)
    assert p_value_ratio_at_least(4.0, Binomial(60, 4000, 10), old) > p_value_ratio_at_least(4.0, new, old)


def test_the_interval_of_the_ratio_ends_where_the_tests_reach_its_tails():
    new, old = Binomial(60, 4000), Binomial(30, 4000)
    low, high = ratio_interval(0.95, new, old)
    assert low < 2.0 < high
    assert p_value_ratio_at_most(low, new, old) == pytest.approx(0.025, rel=0.03)
    assert p_value_ratio_at_least(high, new, old) == pytest.approx(0.025, rel=0.03)


def test_zero_counts_have_unbounded_ratios():
    assert ratio_interval(0.95, Binomial(0, 4000), Binomial(45, 4000))[0] == 0.0
    assert ratio_interval(0.95, Binomial(9, 4000), Binomial(0, 4000))[1] == math.inf
    assert ratio_interval(0.95, Binomial(0, 4000), Binomial(0, 4000)) == (0.0, math.inf)
