"""Variances and tails of products of shares: against the paper's figures, simulation and arviz-stats."""

import numpy as np
import pytest
from arviz_stats.base import array_stats
from studies.error_analysis import (
    nominal_relative_variance,
    overestimate_bound,
    relative_variance,
    underestimate_bound,
)

from avrare_estimators.common.chains.levels import effective_samples, r_hat


def products(levels, samples, share, many=200_000, seed=0):
    """Return estimates over the truth, of independent samples at fixed levels."""
    counts = np.random.default_rng(seed).binomial(samples, share, size=(many, levels))
    return (counts / (samples * share)).prod(axis=1)


def stuck(chains, length, stay, seed=0, many=1):
    """Return chains of hits of share 0.3 that keep their value with probability ``stay``."""
    rng = np.random.default_rng(seed)
    hit = rng.random((many, length, chains)) < 0.3
    for p in range(1, length):
        kept = rng.random((many, chains)) < stay
        hit[:, p] = np.where(kept, hit[:, p - 1], hit[:, p])
    return hit


def test_the_variance_is_that_of_independent_samples():
    assert nominal_relative_variance(20, 100) == pytest.approx(1.01**20 - 1.0)
    for levels, samples, share in ((20, 100, 0.5), (6, 200, 0.1)):
        found = products(levels, samples, share).var()
        assert relative_variance([share] * levels, samples) == pytest.approx(found, rel=0.03)
    assert relative_variance([1.0, 1.0], 10) == 0.0


def test_eq_28_gives_the_papers_figures():
    assert overestimate_bound(2.0, 10, 250) == pytest.approx(0.00246476, rel=1e-5)
    assert overestimate_bound(2.5, 10, 250) == pytest.approx(2.76784e-5, rel=1e-5)
    assert overestimate_bound(2.0, 10, 250, 0.1) == pytest.approx(0.786, abs=1e-3)


@pytest.mark.parametrize(("levels", "samples", "share"), [(10, 250, 0.5), (10, 100, 0.5), (4, 1000, 0.2)])
@pytest.mark.parametrize("factor", [1.2, 1.5, 2.0])
def test_both_bounds_hold(levels, samples, share, factor):
    found = products(levels, samples, share)
    over, under = (found >= factor).mean(), (found <= 1.0 / factor).mean()
    assert over <= overestimate_bound(factor, levels, samples, share)
    assert under <= underestimate_bound(factor, levels, samples, share)


def test_the_bound_on_underestimates_is_useful():
    assert underestimate_bound(2.0, 10, 250) < 0.02
    assert underestimate_bound(2.0, 10, 1000) < 1e-7
    assert underestimate_bound(1.01, 10, 250) == 1.0
    found = products(10, 250, 0.5)
    assert (found <= 0.5).mean() > 2.0 * (found >= 2.0).mean()  # the unsafe side is the likelier one


def test_r_hat_is_that_of_arviz():
    rng = np.random.default_rng(1)
    values = rng.standard_normal((1, 40, 6)) + 0.5 * rng.standard_normal((1, 1, 6))
    expected = array_stats.rhat(values[0].T, chain_axis=0, draw_axis=1, method="identity")
    assert r_hat(values)[0] == pytest.approx(float(expected), rel=1e-9)


def test_effective_sizes_agree_with_arviz_on_long_chains():
    hit = stuck(40, 400, 0.6, seed=3)
    expected = float(array_stats.ess(hit[0].T.astype(float), chain_axis=0, draw_axis=1, method="mean"))
    assert effective_samples(hit)[0] == pytest.approx(expected, rel=0.5)
