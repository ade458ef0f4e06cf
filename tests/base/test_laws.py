"""Laws of drawn options: against SciPy's distributions, far into the tails, and there and back."""

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy import stats

from avrare.base.laws import MOST_VALUES, Law, condense

Z = np.array([-8.0, -5.0, -1.0, 0.0, 0.3, 2.0, 5.0, 8.0])
NORMAL = {"law": "normal", "mean": 2.0, "sd": 0.5}
LOGNORMAL = {"law": "lognormal", "mean": 3.0, "sd": 1.0}
UNIFORM = {"law": "uniform", "low": -1.0, "high": 3.0}


def law(options):
    return TypeAdapter(Law).validate_python(options)


@pytest.mark.parametrize(
    ("options", "reference"),
    [
        (NORMAL, stats.norm(2.0, 0.5)),
        (UNIFORM, stats.uniform(-1.0, 4.0)),
        (LOGNORMAL, stats.lognorm(np.sqrt(np.log1p(1 / 9)), scale=3.0 / np.sqrt(1 + 1 / 9))),
        ({"law": "truncated", "of": NORMAL, "low": 1.0, "high": 2.2}, stats.truncnorm(-2, 0.4, 2.0, 0.5)),
        ({"law": "truncated", "of": NORMAL, "high": -0.5}, stats.truncnorm(-np.inf, -5, 2.0, 0.5)),
    ],
)
def test_values_are_the_quantiles_of_scipy(options, reference):
    low = Z < 1.0
    found = law(options).at(Z)
    assert found[low] == pytest.approx(reference.ppf(stats.norm.cdf(Z[low])), rel=1e-9)
    assert found[~low] == pytest.approx(reference.isf(stats.norm.sf(Z[~low])), rel=1e-6)


@pytest.mark.parametrize(
    "options",
    [
        NORMAL,
        LOGNORMAL,
        UNIFORM,
        {"law": "truncated", "of": LOGNORMAL, "low": 1.0, "high": 4.0},
        {"law": "truncated", "of": NORMAL, "low": 4.5},
        {"law": "mixture", "parts": [{"weight": 1, "of": NORMAL}, {"weight": 3, "of": LOGNORMAL}]},
        {"law": "empirical", "values": [5.0, 1.0, 2.0, 2.5]},
    ],
)
def test_scores_undo_values(options):
    found, numbers = law(options), np.linspace(-4.0, 4.0, 41)
    values = found.at(numbers)
    assert (np.diff(values) > 0.0).all()
    assert found.score(values) == pytest.approx(numbers, abs=1e-6)


def test_a_far_tail_keeps_its_digits():
    cut = law({"law": "truncated", "of": {"law": "normal", "mean": 0.0, "sd": 1.0}, "low": 12.0})
    found = cut.at(Z)
    assert (np.diff(found) > 0.0).all()
    assert found[0] == pytest.approx(12.0)
    exact = stats.norm.isf(np.exp(stats.norm.logsf(12.0) + np.log(0.5)))
    assert found[3] == pytest.approx(exact, rel=1e-12)


def test_a_mixture_has_the_shares_of_its_parts():
    parts = [{"weight": 9, "of": UNIFORM}, {"weight": 1, "of": {"law": "uniform", "low": 5.0, "high": 6.0}}]
    values = law({"law": "mixture", "parts": parts}).at(np.random.default_rng(0).standard_normal(20_000))
    assert (values > 4.0).mean() == pytest.approx(0.1, abs=0.01)
    assert not ((values > 3.001) & (values < 4.999)).any()


def test_an_empirical_law_lies_between_what_was_seen():
    found = law({"law": "empirical", "values": [1.0, 2.0, 2.0, 5.0]})
    assert found.at([-9.0, 0.0, 9.0]) == pytest.approx([1.0, 2.0, 5.0])
    assert float(found.score(2.0)) == pytest.approx(0.0, abs=1e-12)
    column = np.random.default_rng(1).gamma(2.0, size=5000)
    assert len(condense(column)) == MOST_VALUES
    assert np.quantile(condense(column), 0.3) == pytest.approx(np.quantile(column, 0.3), rel=1e-2)


def test_a_discrete_law_has_the_shares_of_its_values():
    found = law({"law": "discrete", "values": [1.0, 4.0, 5.0], "weights": [2.0, 5.0, 3.0]})
    edges = stats.norm.ppf([0.2, 0.7])
    assert found.at([-9.0, edges[0] - 1e-9, edges[0] + 1e-9, edges[1] + 1e-9, 9.0]) == pytest.approx(
        [1.0, 1.0, 4.0, 5.0, 5.0]
    )
    assert found.score([1.0, 4.0, 5.0]) == pytest.approx(stats.norm.ppf([0.1, 0.45, 0.85]))
    assert found.score([0.0, 2.0, 9.0]) == pytest.approx([-np.inf, edges[0], np.inf])
    rare = law({"law": "discrete", "values": [0.0, 1.0], "weights": [1.0, 1e-20]})
    assert rare.at([9.2, 9.4]) == pytest.approx([0.0, 1.0])  # the tail above 9.26 has 1e-20


def test_a_discrete_law_that_is_cut_keeps_the_whole_share_of_its_bounds():
    coins = {"law": "discrete", "values": [1.0, 2.0, 3.0], "weights": [1e308, 1e308, 1e308]}
    mixed = {"law": "mixture", "parts": [{"weight": 1, "of": coins}, {"weight": 1e-9, "of": UNIFORM}]}
    edges = stats.norm.ppf([0.49, 0.51])
    for of in (coins, mixed):
        for bounds, kept in (({"low": 2.0}, [2.0, 3.0]), ({"high": 2.0}, [1.0, 2.0])):
            found = law({"law": "truncated", "of": of, **bounds})
            assert found.at(edges) == pytest.approx(kept, abs=1e-6)


def test_a_value_that_was_seen_often_keeps_its_share_in_composed_laws():
    often = {"law": "empirical", "values": [3.0, 1.0, 1.0, 1.0, 2.0]}
    found = law(often)
    assert found.at(found.score([1.5, 2.0, 2.7])) == pytest.approx([1.5, 2.0, 2.7])
    assert found.score([0.0, 1.0, 4.0]) == pytest.approx([-np.inf, stats.norm.ppf(0.25), np.inf])
    shares = stats.norm.ppf(np.linspace(0.0005, 0.9995, 1000))
    cut = law({"law": "truncated", "of": often, "low": 1.0, "high": 2.0})  # 0.5 and 0.25 of all
    assert np.count_nonzero(cut.at(shares) == 1.0) == pytest.approx(667, abs=1)
    far = {"law": "normal", "mean": 100.0, "sd": 1.0}
    mixed = law({"law": "mixture", "parts": [{"weight": 1, "of": often}, {"weight": 1, "of": far}]})
    drawn = mixed.at(shares)
    assert np.count_nonzero(drawn == 1.0) == pytest.approx(250, abs=1)
    assert np.count_nonzero((drawn > 1.0) & (drawn < 1.5)) == pytest.approx(62, abs=2)


def test_steps_of_composed_laws_are_the_values_themselves():
    coins = {"law": "discrete", "values": [1.0, 2.0, 3.0], "weights": [1.0, 1.0, 1.0]}
    cut = {"law": "truncated", "of": coins, "low": 1.5}
    assert law(cut).at([-40.0, -9.0, 0.1, 9.0]).tolist() == [2.0, 2.0, 3.0, 3.0]
    zeros = {"law": "discrete", "values": [-0.7, 0.0, 0.1], "weights": [1.0, 1.0, 2.0]}
    mixed = law({"law": "mixture", "parts": [{"weight": 1, "of": zeros}, {"weight": 3, "of": cut}]})
    shares = [0.03, 0.06, 0.07, 0.12, 0.13, 0.24, 0.26, 0.6, 0.63, 0.99]
    assert mixed.at(stats.norm.ppf(shares)).tolist() == [-0.7, -0.7, 0.0, 0.0, 0.1, 0.1, 2.0, 2.0, 3.0, 3.0]
    normal = {"weight": 1, "of": {"law": "normal", "mean": 0.0, "sd": 1.0}}
    half = law({"law": "mixture", "parts": [normal, {"weight": 1, "of": coins}]})
    drawn = half.at(stats.norm.ppf(np.linspace(0.001, 0.999, 999)))
    assert [np.count_nonzero(drawn == value) for value in (1.0, 2.0, 3.0)] == pytest.approx([167] * 3, abs=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"law": "discrete", "values": [1.0, 2.0], "weights": [1.0]}, "need as many weights"),
        ({"law": "discrete", "values": [2.0, 1.0], "weights": [1.0, 1.0]}, "values must ascend"),
        ({"law": "uniform", "low": 2.0, "high": 2.0}, "must be below"),
        ({"law": "truncated", "of": NORMAL}, "give low, high or both"),
        ({"law": "truncated", "of": UNIFORM, "low": 7.0}, "no values between"),
        ({"law": "empirical", "values": [2.0, 2.0]}, "all values are the same"),
        ({"law": "normal", "mean": 0.0, "sd": 0.0}, "greater than 0"),
    ],
)
def test_laws_without_meaning_are_refused(options, message):
    with pytest.raises(ValidationError, match=message):
        law(options)
