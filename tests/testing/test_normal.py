"""The normal law against SciPy, far into both tails."""

import numpy as np
from scipy import special, stats

from avrare.testing import normal

X = np.concatenate([np.linspace(-37.0, 37.0, 20_001), [-0.0, 0.0, 0.46875 * 2**0.5, 4 * 2**0.5, -4 * 2**0.5]])


def test_cdf():
    np.testing.assert_allclose(normal.cdf(X), special.ndtr(X), rtol=1e-12)
    x = -5.9978070150076865
    assert normal.probability(x) == np.float64(normal.cdf(np.array([x]))[0])


def test_log_cdf():
    far = np.concatenate([X, [-1e3, -1e10]])
    np.testing.assert_allclose(normal.log_cdf(far), special.log_ndtr(far), rtol=1e-12, atol=1e-300)


def test_pdf():
    np.testing.assert_allclose(normal.pdf(X), stats.norm.pdf(X), rtol=1e-12)


def test_values_do_not_depend_on_their_neighbours():
    x = np.random.default_rng(0).normal(scale=4.0, size=101)
    for function in (normal.cdf, normal.log_cdf, normal.pdf):
        alone = np.concatenate([function(x[i : i + 1]) for i in range(len(x))])
        np.testing.assert_array_equal(function(x), alone)
