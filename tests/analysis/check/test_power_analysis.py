"""Predicted costs: with the predicted rollouts, nine of ten checks reach a verdict."""

import math

import numpy as np
import pytest

from avrare.analysis.check.criteria import Criterion, decide_criteria
from avrare.analysis.check.power_analysis import (
    BASELINE_SHARE,
    count_settling_rollouts,
    describe_coarse_baseline,
    estimate_costs,
    find_variance,
)
from avrare.estimation.result.confidence_distributions import Binomial, LogNormal
from avrare.estimation.result.intervals import clopper_pearson
from avrare.scenario.schema import Regression, Threshold

THRESHOLD = Threshold(specification="rule", probability="< 3e-4")


@pytest.fixture
def entry(estimate):
    def entry(failures, trials):
        p = failures / trials
        error = math.sqrt((1 - p) / (p * trials)) if failures else math.nan
        law = Binomial(failures, trials)
        return estimate(law, relative_error=error, rollouts=trials, simulated_steps=40 * trials)

    return entry


def planned(entry, criterion, baseline=None):
    criteria = [Criterion("s", "rule", criterion, baseline)]
    return estimate_costs("s", criteria, {"rule": entry}, "a pilot run", 0.95)


def decided(estimate, criteria, p, rollouts):
    """Return the share of clear verdicts over draws of ``rollouts``, one for each criterion."""
    rng, clear = np.random.default_rng(3), 0
    for criterion, failures in zip(criteria, rng.binomial(rollouts, p, len(criteria)), strict=True):
        result = estimate(Binomial(int(failures), rollouts))
        clear += bool(decide_criteria([criterion], lambda _: result, 1.0, {}))  # noqa: B023
    return clear / len(criteria)


def comparisons(entry, p, rollouts, many=25):
    """Return criteria against baselines that are drawn with a probability."""
    counts = np.random.default_rng(4).binomial(rollouts, p, many)
    return [Criterion("s", "rule", Regression(), entry(int(count), rollouts)) for count in counts]


@pytest.mark.parametrize(("p", "bound"), [(0.01, "< 0.02"), (0.001, "< 0.01"), (0.02, "< 0.01")])
def test_thresholds(estimate, entry, p, bound):
    criterion = Threshold(specification="rule", probability=bound)
    cost, _ = planned(entry(int(p * 100_000), 100_000), criterion)
    assert 0.84 <= decided(estimate, [Criterion("s", "rule", criterion)] * 200, p, cost.rollouts) <= 0.98
    assert cost.steps == pytest.approx(40 * cost.rollouts)
    assert cost.seconds == pytest.approx(2.0 * cost.rollouts / 100_000)


def test_a_rule_that_was_never_broken(entry):
    criterion = Threshold(specification="rule", probability="< 1e-3")
    cost, precision = planned(entry(0, 200), criterion)
    assert 3688 <= cost.rollouts <= 3700  # ln(40) / 1e-3
    assert "if nothing fails" in cost.reason
    assert precision.rollouts is None
    assert "no failures in" in precision.reason


@pytest.mark.slow
def test_a_regression(estimate, entry):
    baseline = entry(40, 4000)
    cost, _ = planned(baseline, Regression(), baseline)
    criteria = comparisons(entry, 0.01, 4000)
    assert decided(estimate, criteria, 0.01, cost.rollouts) >= 0.7
    assert decided(estimate, criteria, 0.02, cost.rollouts) >= 0.8


def test_a_coarse_baseline_is_named(entry):
    cost, _ = planned(entry(3, 1000), Regression(), entry(3, 1000))
    assert cost.rollouts is None
    assert "its relative error is 58 %, not 11 % or less" in cost.reason
    assert "make another with --save --budget rollouts=30000" in cost.reason
    cost, _ = planned(entry(0, 1000), Regression(), entry(0, 1000))
    assert "use a threshold" in cost.reason


def test_a_baseline_and_a_check_of_their_shares_decide(estimate, entry):
    variance = find_variance(Regression())
    sizes = [round(0.99 / (0.01 * share * variance)) for share in (BASELINE_SHARE, 1.0 - BASELINE_SHARE)]
    criteria = comparisons(entry, 0.01, sizes[0], many=40)
    assert not any(describe_coarse_baseline(Regression(), criterion.baseline) for criterion in criteria)
    assert decided(estimate, criteria, 0.01, sizes[1]) >= 0.85
    assert decided(estimate, criteria, 0.03, sizes[1]) >= 0.95


def test_a_baseline_is_as_imprecise_as_its_interval(estimate):
    for variance, coarse in ((0.01, False), (0.25, True)):
        baseline = estimate(LogNormal(4e-5, variance, 100), relative_error=0.1, rollouts=20_000)
        text = describe_coarse_baseline(Regression(), baseline)
        assert bool(text) == coarse
    assert "its relative error is 48 %, not 11 % or less; make another with --save --seed N" in text


def test_precision(estimate, entry):
    *_, cost = planned(entry(100, 10_000), Regression(), entry(100, 10_000))
    _, high = Binomial(round(0.01 * cost.rollouts), cost.rollouts).interval_at(0.95)
    assert high / 0.01 == pytest.approx(1.2, abs=0.02)


def test_other_estimators_are_planned_by_their_own_variance(estimate):
    law = LogNormal(1e-4, 0.02, 9)
    entry = estimate(law, relative_error=math.sqrt(0.02), rollouts=20_000)
    cost, settling, precision = planned(entry, Threshold(specification="rule", probability="< 3e-4"))
    factor = 1.959964 + 1.281552
    assert cost.rollouts == pytest.approx(0.02 * 20_000 * (factor / math.log(3)) ** 2, rel=0.05)
    assert precision.rollouts == pytest.approx(0.02 * 20_000 * (1.959964 / math.log(1.2)) ** 2, rel=0.05)
    assert settling.question == "< 3e-4, all seen"
    assert settling.rollouts == pytest.approx(count_settling_rollouts(THRESHOLD, 1e-4), rel=0.05)


def test_settling_rollouts_prove_a_threshold():
    rollouts = count_settling_rollouts(THRESHOLD, 0.0)
    ends = [clopper_pearson(0, count, 0.95)[1] for count in (rollouts - 1, rollouts)]
    assert ends[1] <= 3e-4 < ends[0]
    failures = np.random.default_rng(5).binomial(count_settling_rollouts(THRESHOLD, 1e-4), 1e-4, 2000)
    rollouts = count_settling_rollouts(THRESHOLD, 1e-4)
    ends = {count: clopper_pearson(count, rollouts, 0.95)[1] for count in set(failures.tolist())}
    assert np.mean([ends[count] < 3e-4 for count in failures.tolist()]) == pytest.approx(0.93, abs=0.04)
    assert count_settling_rollouts(THRESHOLD, 3e-4) is None
