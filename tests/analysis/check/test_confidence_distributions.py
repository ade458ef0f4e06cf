"""p-values, compared with the intervals they come from and with exact laws."""

import json
from functools import partial

import pytest

from avrare.base.errors import UsageError
from avrare.estimation.result import intervals
from avrare.estimation.result.confidence_distributions import (
    Binomial,
    InverseBinomial,
    LogNormal,
    Tabulated,
    decode_distribution,
    derive_distribution,
    encode_distribution,
)

LAWS = [
    Binomial(3, 200), Binomial(0, 50), Binomial(50, 50), Binomial(7, 90, 4), InverseBinomial(6, 400),
    InverseBinomial(6, 400, 3), LogNormal(1e-4, 0.04, 9), LogNormal(1e-4, 0.04, 0),
    LogNormal(0.02, 0.1, 4, 0.001), LogNormal(1e-4, 0.04, 9, 1e-6, (-9.1, 0.09)),
]  # fmt: skip
TWO_SIDED = [law for law in LAWS if getattr(law, "failures", 1) not in (0, 50)]
"""Laws that say something at either end."""


@pytest.mark.parametrize("law", TWO_SIDED, ids=str)
@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
def test_the_interval_ends_where_the_p_values_reach_its_tails(law, confidence):
    low, high = law.interval_at(confidence)
    tail = (1 - confidence) / 2
    assert law.p_value_at_most(low) == pytest.approx(tail, rel=1e-6)
    assert law.p_value_at_least(high) == pytest.approx(tail, rel=1e-6)


def test_an_end_that_says_nothing_leaves_the_tail_of_the_other():
    assert Binomial(0, 50).p_value_at_least(Binomial(0, 50).interval_at(0.95)[1]) == pytest.approx(0.025)
    assert Binomial(50, 50).p_value_at_most(Binomial(50, 50).interval_at(0.95)[0]) == pytest.approx(0.025)


def test_binomial_p_values_are_those_of_scipy():
    from scipy.stats import binom

    for failures, trials, value in [(3, 200, 0.01), (0, 50, 0.1), (12, 40, 0.2), (40, 40, 0.9)]:
        law = Binomial(failures, trials)
        assert law.p_value_at_most(value) == pytest.approx(binom.sf(failures - 1, trials, value), abs=1e-12)
        assert law.p_value_at_least(value) == pytest.approx(binom.cdf(failures, trials, value), abs=1e-12)


def test_inverse_binomial_p_values_are_those_of_scipy():
    from scipy import stats

    law = InverseBinomial(6, 400)  # 394 successes before the sixth failure
    assert law.p_value_at_most(0.01) == pytest.approx(stats.nbinom.cdf(394, 6, 0.01))
    assert law.p_value_at_least(0.03) == pytest.approx(stats.nbinom.sf(393, 6, 0.03))


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_p_values_are_monotone_between_0_and_1(law):
    values = [0.0, 1e-7, 1e-5, 1e-4, 1e-3, 0.01, 0.05, 0.3, 0.9, 1.0]
    above, below = [law.p_value_at_most(v) for v in values], [law.p_value_at_least(v) for v in values]
    assert above == sorted(above)
    assert below == sorted(below, reverse=True)
    assert all(0.0 <= p <= 1.0 for p in above + below)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_a_table_is_never_less_conservative_than_its_law(law):
    table = Tabulated.from_intervals(law.interval_at)
    for value in [1e-5, 5e-5, 2e-4, 1e-3, 0.01, 0.03, 0.06, 0.2, 0.8]:
        assert table.p_value_at_most(value) >= law.p_value_at_most(value) * (1 - 1e-9)
        assert table.p_value_at_least(value) >= law.p_value_at_least(value) * (1 - 1e-9)
    assert table.interval_at(0.95) == pytest.approx(law.interval_at(0.95))


def test_an_unknown_interval_has_p_values_of_one():
    table = Tabulated.from_intervals(intervals.unknown)
    assert (table.p_value_at_most(0.5), table.p_value_at_least(0.5)) == (1.0, 1.0)
    assert table.interval_at(0.95) == (0.0, 1.0)


def test_the_core_laws_are_known_by_their_intervals(estimate):
    at = partial(intervals.clopper_pearson, 4, 90, errors=2)
    assert derive_distribution(estimate(interval_at=at)) == Binomial(4, 90, 2)
    at = partial(intervals.inverse_binomial, 4, 90, errors=2)
    assert derive_distribution(estimate(interval_at=at)) == InverseBinomial(4, 90, 2)
    at = partial(intervals.log_normal, 1e-3, 0.1, freedom=9, errors=0.01)
    assert derive_distribution(estimate(interval_at=at)) == LogNormal(1e-3, 0.1, 9, 0.01)
    assert isinstance(derive_distribution(estimate(interval_at=lambda c: (0.1, 0.2 + c / 2))), Tabulated)


@pytest.mark.parametrize(
    "law", [*LAWS, Tabulated.from_intervals(Binomial(3, 90).interval_at)], ids=lambda law: type(law).__name__
)
def test_a_law_survives_encoding(law):
    assert decode_distribution(json.loads(json.dumps(encode_distribution(law)))) == law


@pytest.mark.parametrize(
    "plain",
    [
        {},
        {"law": "poisson"},
        {"law": "binomial", "failures": 3},
        {"law": "log_normal", "mean": float("nan"), "relative_variance": 0.1, "freedom": 3},
        {"law": "tabulated", "tails": [0.05], "lower": [0.1, 0.05], "upper": [0.2]},
    ],
)
def test_other_data_are_a_clear_error(plain):
    with pytest.raises(UsageError, match="not an estimate"):
        decode_distribution(plain)
