"""Two unlike estimates of one probability: combined where they agree, wide where they do not."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import avrare
from avrare.estimation.combine.witnesses import LEAST_POWER, power_to_notice, reconcile
from avrare.estimation.result import intervals
from avrare.estimation.result.doubts import open_interval
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.testing.problems import reference_problem


@pytest.fixture(scope="module")
def template():
    return avrare.estimate(reference_problem("a_beta_-2").problem(), "mc", rollouts=100)


def witness(template, name, probability, error=0.2, health=()):
    fresh = FreshRows(5000)
    at = partial(intervals.log_normal, probability, error**2, freedom=20) if probability else fresh.interval
    result = replace(
        template,
        estimator=name,
        probability=probability,
        relative_error=error,
        interval_at=at,
        run_probabilities=np.array([probability]),
        health=dict.fromkeys(health, "a reason"),
        fresh=fresh,
    )
    return open_interval(result, health)


def test_agreement_answers_a_doubt_and_halves_are_fixed(template):
    first, second = witness(template, "is", 1e-4, health=["unchecked"]), witness(template, "ams", 1.2e-4)
    result, outcome, words = reconcile(first, second, 0.95)
    assert (result.probability, result.health) == (pytest.approx(1.1e-4), {})
    assert result.run_probabilities.mean() == result.probability
    assert result.interval[1] < 2e-4 < first.interval[1]
    assert result.rollouts == first.rollouts + second.rollouts
    assert result.fresh.rows == 10_000
    assert outcome == "agree"
    assert "agree, and a miss by a factor 3 would have been noticed in" in words
    assert result.diagnostics["witnesses"]["power"] > 0.8


@pytest.mark.parametrize("name", ["unchecked", "leaps"])
def test_a_method_does_not_answer_for_its_own_doubts(template, name):
    first = witness(template, "ams", 1e-4, health=[name])
    result, outcome, _ = reconcile(first, witness(template, "ams", 1.2e-4), 0.95)
    assert outcome == "agree"
    assert name in result.health
    assert result.interval[1] >= result.fresh.interval(0.95)[1]


def test_disagreement_is_wide_and_the_larger_stands(template):
    result, outcome, words = reconcile(witness(template, "is", 1e-5), witness(template, "ams", 2e-4), 0.95)
    assert outcome == "disagree"
    assert (result.estimator, result.probability) == ("ams", 2e-4)
    assert "contradicted" in result.health
    low, high = result.interval
    assert low < 1e-5
    assert high >= result.fresh.interval(0.95)[1]
    assert "disagree" in words


@pytest.mark.parametrize("name", ["outliers", "unchecked"])
def test_a_finding_of_a_probe_holds_until_its_doubt_is_answered(template, name):
    first = open_interval(witness(template, "is", 1e-4), [name], least_upper=0.02)
    first = replace(first, health={name: "a reason"})
    for probability in (1.2e-4, 0.0):  # agrees; says too little
        result, _, _ = reconcile(first, witness(template, "ams", probability), 0.95)
        doubted = name in result.health
        assert doubted == (name == "outliers" or not probability)
        assert (result.interval[1] >= 0.02) == doubted


@pytest.mark.parametrize(("probability", "error"), [(0.0, np.nan), (3e-4, 1.0)])
def test_a_witness_of_little_power_answers_nothing(template, probability, error):
    first = witness(template, "is", 1e-4, health=["unchecked"])
    result, outcome, words = reconcile(first, witness(template, "ams", probability, error), 0.95)
    assert outcome == "inconclusive"
    assert result.diagnostics["witnesses"]["power"] < LEAST_POWER
    assert "says too little" in words
    assert result.probability == first.probability
    assert "unchecked" in result.health
    assert result.interval[1] == FreshRows(10_000).interval(0.95)[1] < first.interval[1]


def test_the_surer_of_two_stands_where_only_the_first_is_in_doubt(template):
    first = witness(template, "ams", 1e-4, 0.9, ["leaps"])
    for error, health, stands in ((0.2, (), "ess"), (0.2, ["few_roots"], "ams"), (1.2, (), "ams")):
        result, outcome, words = reconcile(first, witness(template, "ess", 1.5e-4, error, health), 0.95)
        assert (outcome, result.estimator) == ("inconclusive", stands)
        assert ("leaps" in result.health) == (stands == "ams")
        assert "says too little" in words


def test_a_witness_that_may_miss_failures_contradicts_none_that_finds_more(template):
    low, high = witness(template, "is", 1e-5, health=["unchecked"]), witness(template, "ams", 2e-4)
    result, outcome, _ = reconcile(low, high, 0.95)
    assert (outcome, result.probability, result.health) == ("disagree", 2e-4, {})
    assert result.interval == high.interval


def test_power_is_the_share_of_misses_that_would_have_been_noticed():
    rng, errors, threshold = np.random.default_rng(1), (0.2, 0.3), 2.0
    spread = np.sqrt(np.log1p(np.square(errors)))
    logs = rng.standard_normal((2, 100_000)) * spread[:, None]
    noticed = np.abs(np.log(3.0) + logs[0] - logs[1]) > np.log(threshold)
    assert power_to_notice(threshold, errors) == pytest.approx(noticed.mean(), abs=0.01)
    assert power_to_notice(threshold, (0.2, np.nan)) == 0.0
    assert power_to_notice(np.inf, errors) == 0.0
