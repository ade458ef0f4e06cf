"""Doubts of an estimate, which open its interval, and two unlike estimates of one probability."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import avrare
from avrare.base.health_messages import MESSAGES
from avrare.estimation.checks.result_builder import contradict
from avrare.estimation.combine.witnesses import LEAST_POWER, power_to_notice, reconcile
from avrare.estimation.result import intervals
from avrare.estimation.result.doubts import (
    DOUBTS,
    MAY_MISS_FAILURES,
    MAY_SCATTER,
    answer_doubts,
    open_interval,
)
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.plugin.registry import default_registry
from avrare.testing.problems import reference_problem

FRESH = FreshRows(rows=10_000, failures=1)


@pytest.fixture(scope="module")
def template():
    return avrare.estimate(reference_problem("a_beta_-2").problem(), "mc", rollouts=100)


@pytest.fixture(scope="module")
def result(template):
    at = lambda confidence: intervals.log_normal(1e-4, 0.01, confidence, freedom=20)  # noqa: E731
    return replace(template, probability=1e-4, interval_at=at, fresh=FRESH)


@pytest.mark.parametrize("name", sorted(DOUBTS))
def test_every_doubt_opens_the_upper_end_to_what_target_rows_allow(result, name):
    low, high = open_interval(result, [name]).interval
    assert high == FRESH.interval(0.95)[1] > result.interval[1]
    assert low == (result.interval[0] if name in MAY_MISS_FAILURES else pytest.approx(0.025 * 1e-4))


def test_an_interval_holds_what_a_check_has_found(result):
    assert open_interval(result, ["outliers"], least_upper=0.2).interval[1] == 0.2


def test_other_warnings_open_nothing(result):
    assert open_interval(result, ["all_failed", "errors", "horizon_short"]) is result
    assert open_interval(replace(result, fresh=None), ["outliers"]).interval == result.interval


def test_degenerate_weights_are_not_asked_for_their_scatter(result):
    wide = replace(result, interval_at=lambda confidence: (1e-9, 0.9))
    assert open_interval(wide, ["unchecked"]).interval[1] == 0.9
    assert open_interval(wide, ["weight_degenerate"]).interval[1] == FRESH.interval(0.95)[1]


@pytest.mark.parametrize(("rows", "failures"), [(10_000, 9), (400_000, 2)])
def test_target_rows_contradict_an_interval_that_lies_beside_theirs(result, rows, failures):
    found = replace(result, fresh=FreshRows(rows, failures))
    warning = contradict(found)
    assert f"{failures} of {rows} rollouts of the target failed" in warning["contradicted"]
    (low, high), counted = open_interval(found, warning).interval, found.fresh.interval(0.95)
    assert low <= counted[1]
    assert counted[0] <= high
    assert contradict(result) == {}


def test_at_most_twelve_warnings_doubt_an_interval_and_each_says_what_to_do():
    registry = default_registry()
    texts = dict(MESSAGES)
    for name in ("ams", "ess", "is"):
        texts |= registry.get("estimator", name).warnings
    assert len(DOUBTS) <= 12
    assert not MAY_MISS_FAILURES & MAY_SCATTER
    for name in DOUBTS - {"heuristic_kernel"}:  # its text is the kernel's
        assert any(word in texts[name] for word in ("use ", "compare with", "raise ")), name


@pytest.mark.parametrize("rows", [5_000, 100_000])
@pytest.mark.parametrize("name", ["unchecked", "contradicted"])
def test_target_rows_answer_a_doubt_of_missed_failures_that_they_bound(result, name, rows):
    doubted = replace(result, fresh=FreshRows(rows), health={name: "a reason", "errors": "many"})
    opened = open_interval(doubted, [name])
    answered = answer_doubts(opened)
    assert answered.interval == opened.interval
    if rows == 100_000 and name == "unchecked":
        assert list(answered.health) == ["errors"]
        assert answered.notes[-1].text.endswith("which see every failure: a reason.")
    else:
        assert answered is opened


def test_an_open_interval_is_never_narrowed_by_a_later_doubt(template):
    at = partial(intervals.log_normal, 1e-4, 0.04, freedom=20)
    result = replace(template, probability=1e-4, interval_at=at, fresh=FreshRows(50_000))
    opened = open_interval(result, ["outliers"], least_upper=0.02)
    for later in (["contradicted"], ["weight_degenerate"]):
        low, high = open_interval(opened, later, least_upper=0.01).interval
        assert high >= 0.02
        assert low <= opened.interval[0]


def witness(template, name, probability, error=0.2, health=()):
    fresh = FreshRows(5000)
    at = partial(intervals.log_normal, probability, error**2, freedom=20) if probability else fresh.interval
    result = replace(
        template, estimator=name, probability=probability, relative_error=error, interval_at=at,
        run_probabilities=np.array([probability]), health=dict.fromkeys(health, "a reason"), fresh=fresh,
    )  # fmt: skip
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
