"""Parts of a final sample that count by shares fixed before, the end of learning, and the fit between."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from outlier_systems import outliers, peak

import avrare
from avrare_estimators.common.learning import dictionary
from avrare_estimators.common.learning.pooled_samples import PooledSamples
from avrare_estimators.common.samples.cross_check import GROUPS, CrossCheckResult
from avrare_estimators.common.samples.result import RunOutcome, _pooled_quality
from avrare_estimators.common.samples.sampling import Sample
from avrare_estimators.common.samples.sources import Stratum, TapeSource
from avrare_estimators.common.samples.stages import has_reached, is_worthless
from avrare_estimators.importance.config import IsConfig
from avrare_estimators.importance.learned_sampling import LearnedSampling


def test_a_gain_that_no_failure_shows_is_worth_nothing():
    stage = {"gain": 8.0, "gain_shown": None}
    assert not is_worthless(stage)
    assert not is_worthless({**stage, "gain_shown": 1.5})
    assert is_worthless({**stage, "gain_shown": 1.1})
    assert is_worthless({**stage, "gain": 1.9})


def made_sample(violated, log_ratio, target_rows, error=None):
    plan, n = None, len(violated)
    strata = tuple(
        Stratum(plan, 0, 0, rows, target) for rows, target in ((target_rows, True), (n - target_rows, False))
    )
    zeros, error = np.zeros(n), np.zeros(n, dtype=bool) if error is None else error
    return Sample(TapeSource(None), strata, np.array(log_ratio), np.array(violated), error, zeros, zeros, ())


def made_run():
    """Return a run whose final sample and two stages have the shares 0.5, 0.2 and 0.3, and its samples."""
    rng = np.random.default_rng(3)
    samples = [
        made_sample(rng.random(n) < 0.5, rng.normal(size=n), n // 4, rng.random(n) < 0.1)
        for n in (40, 80, 20)
    ]
    final, *stages = samples
    return RunOutcome(final, False, None, (), ((0.2, stages[0]), (0.3, stages[1]))), samples


def test_an_estimate_is_the_sum_of_its_samples_by_their_shares():
    run, samples = made_run()
    shares, means, variances = (0.5, 0.2, 0.3), [], []
    for sample in samples:
        n, target = len(sample.violated), sample.target_rows
        weight = 1.0 / (0.25 + 0.75 * np.exp(-sample.log_ratio)) * sample.violated
        means.append(weight.mean())
        own, other = weight[:target], weight[target:]
        variances.append((len(own) * own.var(ddof=1) + len(other) * other.var(ddof=1)) / n**2)
    assert run.probability == pytest.approx(np.dot(shares, means))
    assert run.variance(2.0) == pytest.approx(np.dot(np.square(shares), variances) / 4.0)


def test_a_check_that_finds_more_than_chance_explains_widens_the_interval():
    run, _ = made_run()
    low, high = (replace(run, cross_check=check(factor * run.probability)) for factor in (0.5, 3.0))
    assert run.shortfall(1.0) == low.shortfall(1.0) == 0.0
    variance = high.variance(1.0) + high.cross_check.variance(1.0)
    assert high.shortfall(1.0) == pytest.approx((2.0 * run.probability) ** 2 - variance)
    assert high.shortfall(2.0) == pytest.approx(high.shortfall(1.0) / 4.0)
    assert replace(run, cross_check=check(1.01 * run.probability)).shortfall(1.0) == 0.0
    assert replace(run, cross_check=CrossCheckResult((), 100)).shortfall(1.0) == 0.0


def check(around):
    return CrossCheckResult(tuple(around * np.linspace(0.9, 1.1, GROUPS)), rollouts=4000)


def test_the_doubts_about_an_estimate_are_those_of_all_its_samples():
    run, samples = made_run()
    terms, broken = [], 0.0
    for share, sample in zip((0.5, 0.2, 0.3), samples, strict=True):
        weight = share / len(sample.error) / (0.25 + 0.75 * np.exp(-sample.log_ratio))
        terms.append(weight * sample.violated)
        broken += float((weight * sample.error).sum())
    terms = np.concatenate(terms)
    assert run.error_weight == pytest.approx(broken)
    marks = _pooled_quality([run])
    assert marks.effective_failures == pytest.approx(terms.sum() ** 2 / (terms**2).sum())
    assert marks.largest_share == pytest.approx(terms.max() / terms.sum())


def test_the_variance_that_a_sample_shows_is_that_of_one_of_its_rows():
    rng = np.random.default_rng(4)
    sample = made_sample(rng.random(4000) < 0.3, rng.normal(size=4000), 1000)
    weight = 1.0 / (0.25 + 0.75 * np.exp(-sample.log_ratio)) * sample.violated
    parts = 0.25 * weight[:1000].var(ddof=1) + 0.75 * weight[1000:].var(ddof=1)
    assert PooledSamples(0.25, (sample,)).fresh_variance == pytest.approx(parts / weight.mean() ** 2)
    few = made_sample(np.arange(4000) < 9, np.zeros(4000), 1000)
    assert PooledSamples(0.25, (few,)).fresh_variance is None


def test_learning_ends_where_an_estimate_is_nearly_done():
    def ends(variance, goal=0.1, reached=True):
        stage = {"rollouts": 3000, "reached": reached, "relative_variance": 9.0, "gain": 5.0}
        state = SimpleNamespace(
            stages=[stage],
            rows=4000,
            rollouts=100_000,
            pool=SimpleNamespace(fresh_variance=variance, elite=[np.arange(99)], mixtures=(None,)),
        )
        return LearnedSampling(IsConfig(relative_error=goal, pilot=3000))._has_learnt(state)

    assert ends(29.0)  # 2,900 rows are missing, fewer than two stages of 1,500
    assert not ends(31.0)
    assert not ends(29.0, reached=False)
    assert not ends(29.0, goal=None)
    assert not ends(None)


def test_a_first_part_of_the_final_sample_tells_how_large_the_rest_must_be():
    results = [
        avrare.estimate(outliers("always (first < 4)"), "is", seed=seed, relative_error=goal)
        for seed, goal in ((1, 0.1), (2, 0.05))
    ]
    for result, goal in zip(results, (0.1, 0.05), strict=True):
        (shares,) = result.diagnostics["shares"]
        assert sum(shares) == pytest.approx(1.0, abs=1e-3)
        assert shares[0] == pytest.approx(2.0 * shares[1], abs=1e-3)
        assert result.relative_error < 1.25 * goal


def test_the_first_part_leaves_the_rest_as_many_rollouts_as_its_share():
    for goal, rollouts in ((0.02, 12_000), (0.05, 8000)):
        options = {"relative_error": goal, "rollouts": rollouts}
        result = avrare.estimate(outliers("always (first < 4)"), "is", seed=1, **options)
        counted = (
            result.rollouts - result.diagnostics["check_rollouts"] - result.diagnostics["learning_rollouts"]
        )
        assert result.diagnostics["rows"][0] == pytest.approx(2.0 * counted / 3.0, abs=1.0)
        assert result.probability == pytest.approx(peak(4.0), rel=0.5)
        assert "weight_degenerate" not in result.health


def test_learning_knows_failures_where_enough_are_among_its_elite():
    assert has_reached({"reached": True})
    assert has_reached({"reached": False, "failures_effective": 41.0})
    assert not has_reached({"reached": False, "failures_effective": 39.0})
    assert not has_reached({"reached": False})


def test_a_fit_takes_the_rounds_that_pay(monkeypatch):
    rng = np.random.default_rng(6)
    tapes = rng.standard_normal((2, 100, 21, 6))
    tapes[..., 7, 4] = 3.5 * np.sign(tapes[..., 7, 4])

    def second_moment():
        mixture = dictionary.fit(tapes[0], np.ones(100), 0.25)
        return np.mean(1.0 / (0.25 + 0.75 * np.exp(-mixture.log_ratio_of(tapes[1]))))

    chosen = second_moment()
    monkeypatch.setattr(dictionary, "_best_rounds", lambda *_: 1)
    assert chosen < 0.7 * second_moment()
