"""Laws of one number: against SciPy, in both tails, and undone by their own distribution function."""

import numpy as np
import pytest
from scipy import special, stats

from avrare.base.errors import UsageError
from avrare_flows import marginals as m
from avrare_flows.composite_laws import Mixture, Scipy, Truncated, beam

LAWS = {
    "normal": (m.Normal(1.0, 2.0), stats.norm(1.0, 2.0)),
    "lognormal": (m.LogNormal(0.3, 0.5), stats.lognorm(0.5, scale=np.exp(0.3))),
    "exponential": (m.Exponential(2.0), stats.expon(scale=2.0)),
    "weibull": (m.Weibull(1.7, 3.0), stats.weibull_min(1.7, scale=3.0)),
    "gamma": (m.Gamma(2.5, 0.4), stats.gamma(2.5, scale=0.4)),
    "gumbel": (m.Gumbel(-1.0, 0.7), stats.gumbel_r(-1.0, 0.7)),
    "student": (m.StudentT(4.0, 1.0, 2.0), stats.t(4.0, 1.0, 2.0)),
    "uniform": (m.Uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0)),
}
Z = np.concatenate([np.linspace(-8.0, 8.0, 161), [-1e-9, 1e-9]])
MIXED = Mixture((1.0, 3.0), (m.Normal(-2.0, 0.1), m.Exponential()))


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_scipys_in_both_tails(name):
    law, peer = LAWS[name]
    expected = np.where(Z <= 0.0, peer.ppf(stats.norm.cdf(Z)), peer.isf(stats.norm.sf(Z)))
    np.testing.assert_allclose(m.from_normal(law, Z), expected, rtol=1e-9, atol=1e-12)
    x = m.from_normal(law, np.linspace(-5.0, 5.0, 41))
    lower, upper = law.tails(x)
    np.testing.assert_allclose(lower, peer.cdf(x), rtol=1e-9)
    np.testing.assert_allclose(upper, peer.sf(x), rtol=1e-9)
    np.testing.assert_allclose(law.log_density(x), peer.logpdf(x), rtol=1e-9)


@pytest.mark.parametrize("law", [*(law for law, _ in LAWS.values()), MIXED, Truncated(m.Normal(), -1.0, 6.0)])
def test_the_distribution_function_undoes_the_transform(law):
    z = np.linspace(-6.0, 6.0, 121)
    if isinstance(law, m.Uniform | Truncated):
        z = z[np.abs(z) < 3.0]  # near a finite end x has no digits left to tell z by
    np.testing.assert_allclose(m.to_normal(law, m.from_normal(law, z)), z, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize(("low", "high"), [(-1.0, 2.0), (5.0, np.inf), (-np.inf, -7.0), (8.0, 9.0)])
def test_a_truncated_normal_is_scipys_even_in_a_tail(low, high):
    z = np.linspace(-4.0, 4.0, 33)
    law, peer = Truncated(m.Normal(), low, high), stats.truncnorm(low, high)
    expected = np.where(z <= 0.0, peer.ppf(stats.norm.cdf(z)), peer.isf(stats.norm.sf(z)))
    found = m.from_normal(law, z)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    np.testing.assert_allclose(law.log_density(found), peer.logpdf(found), rtol=1e-7)
    assert law.log_density(np.array([low - 1.0, high + 1.0])).tolist() == [-np.inf, -np.inf]


@pytest.mark.parametrize("freedom", [0.5, 1.0, 2.5, 3.0, 10.0, 300.0])
def test_the_far_tails_of_students_law_are_exact(freedom):
    law = m.StudentT(freedom)
    z = np.linspace(5.0, {0.5: 18.0, 1.0: 26.0}.get(freedom, 36.0), 500)
    x = m.from_normal(law, z)
    assert (np.diff(x) > 0.0).all()
    assert np.array_equal(m.from_normal(law, -z), -x)
    np.testing.assert_allclose(m.to_normal(law, x), z, rtol=1e-9)
    cauchy = m.from_normal(m.StudentT(1.0), np.array([-37.0]))  # -1 / (pi p) so far out
    np.testing.assert_allclose(cauchy, -1.0 / (np.pi * special.ndtr(-37.0)), rtol=1e-11)


def test_a_truncation_without_probability_is_refused():
    with pytest.raises(UsageError, match="Weibull has no probability"):
        Truncated(m.Exponential(), -3.0, -1.0)
    with pytest.raises(UsageError, match="Normal has no probability"):
        Truncated(m.Normal(), 50.0)


def test_a_mixture_has_the_distribution_function_of_its_parts():
    z = np.linspace(-7.0, 7.0, 71)
    x = m.from_normal(MIXED, z)
    assert (np.diff(x) >= 0.0).all()
    lower, upper = MIXED.tails(x)
    np.testing.assert_allclose(np.where(z <= 0.0, lower, upper), stats.norm.sf(np.abs(z)), rtol=1e-10)


@pytest.mark.slow
def test_the_beam_model_is_that_of_thrun():
    law = beam(4.0, 10.0, std=0.1, decay=2.0, hit=0.7, short=0.2, nothing=0.06, anything=0.04)
    z = np.random.default_rng(0).standard_normal(200_000)
    x = m.from_normal(law, z)
    assert x.min() >= 0.0
    assert x.max() == 10.0
    share = np.array([(x == 10.0).mean(), (np.abs(x - 4.0) < 0.4).mean(), (x < 3.0).mean()])
    between = stats.truncexpon(2.0, scale=2.0)  # kept to 4 m, two means
    near = 0.7 * (1.0 - 2.0 * stats.norm.sf(4.0)) + 0.2 * (1.0 - between.cdf(3.6)) + 0.04 * 0.08
    expected = np.array([0.06, near, 0.2 * between.cdf(3.0) + 0.04 * 0.3])
    assert np.abs(share - expected).max() < 4.0 * 0.5 / np.sqrt(len(x))


def test_a_beam_may_have_a_distance_for_each_particle():
    distance, z = np.array([2.0, 5.0, 9.5]), np.array([-1.0, 0.3, 1.2])
    options = {"std": 0.1, "decay": 2.0, "hit": 0.8, "short": 0.1, "nothing": 0.05, "anything": 0.05}
    together = m.from_normal(beam(distance, 10.0, **options), z)
    for row in range(3):
        alone = m.from_normal(beam(distance[row], 10.0, **options), z[row : row + 1])
        assert together[row] == alone[0]


def test_any_distribution_of_scipy_works():
    law, peer = Scipy(stats.skewnorm(4.0)), stats.skewnorm(4.0)
    z = np.array([-3.0, 0.0, 2.0, 6.0])
    x = m.from_normal(law, z)
    np.testing.assert_allclose(peer.cdf(x[:3]), stats.norm.cdf(z[:3]), rtol=1e-6)
    assert peer.sf(x[3]) == pytest.approx(stats.norm.sf(6.0), rel=1e-6)
    np.testing.assert_allclose(law.log_density(x), peer.logpdf(x))


@pytest.mark.parametrize(
    "make",
    [lambda: m.Normal(0.0, 0.0), lambda: m.Gamma(-1.0), lambda: m.StudentT(0.0), lambda: m.Uniform(1, 1)],
)
def test_invalid_parameters_of_a_law_are_refused(make):
    with pytest.raises(UsageError, match="must"):
        make()
