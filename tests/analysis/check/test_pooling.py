"""Pooled batches: the estimate equals that of one large batch."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from avrare.analysis.check.pooling import pool
from avrare.estimation.result import intervals
from avrare.estimation.result.confidence_distributions import (
    Binomial,
    LogNormal,
    Tabulated,
    derive_distribution,
)
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import CrossCheckResult


def runs(estimate, values, **changes):
    values = np.array(values)
    mean = float(values.mean())
    spread = float(values.var(ddof=1)) / len(values) / mean**2 if mean else 0.0
    at = intervals.unknown
    if mean:
        logs = intervals.cox(values)
        at = partial(intervals.log_normal, mean, spread, freedom=len(values) - 1, logs=logs)
    return estimate(interval_at=at, probability=mean, run_probabilities=values, estimator="ams", **changes)


def test_counts_add_up(estimate):
    whole = pool([estimate(Binomial(2, 100, 1)), estimate(Binomial(5, 300, 2))], 0.01)
    assert derive_distribution(whole) == Binomial(7, 400, 3)
    assert whole.interval == intervals.clopper_pearson(7, 400, 0.95, 3)
    assert (whole.probability, whole.rollouts, whole.seconds, whole.failures.count) == (
        7 / 400,
        2000,
        4.0,
        10,
    )


def test_runs_are_pooled_and_extinct_ones_count(estimate):
    first, second = [1e-4, 2e-4, 0.0], [3e-4, 2e-4]
    whole = pool([runs(estimate, first), runs(estimate, second)], 0.01)
    assert whole.probability == pytest.approx(1.6e-4)
    assert derive_distribution(whole) == derive_distribution(runs(estimate, first + second))
    dead = pool([runs(estimate, [0.0, 0.0]), runs(estimate, second)], 0.01)
    assert dead.probability == pytest.approx(1.25e-4)
    assert dead.interval == pytest.approx(runs(estimate, [0.0, 0.0, *second]).interval)


def test_single_runs_are_weighted_by_their_planned_shares(estimate):
    """Weigh by planned rollouts: those taken depend on the outcome, and a lucky run costs more."""
    means, errors = [1e-3, 1e-3, 2e-3], [0.04, 0.04, 0.01]
    batches = [
        estimate(LogNormal(mean, error, 20), rollouts=rollouts)
        for mean, error, rollouts in zip(means, errors, [500, 1500, 9000], strict=True)
    ]
    law = derive_distribution(pool(batches, 0.01))
    assert law.mean == pytest.approx(1.5e-3)
    variance = 2 * (0.25 * 1e-3) ** 2 * 0.04 + (0.5 * 2e-3) ** 2 * 0.01
    assert law.relative_variance == pytest.approx(variance / 1.5e-3**2)
    assert law.freedom == 60


def test_single_runs_of_splitting_are_runs_of_one_estimate(estimate):
    alone = {"health": {"single_run": "only one run ..."}, "run_probabilities": np.array([1e-3])}
    batches = [estimate(LogNormal(1e-3, 0.1, 0), **alone), runs(estimate, [2e-3, 4e-3])]
    whole = pool(batches, 0.01)
    assert whole.interval == pytest.approx(runs(estimate, [1e-3, 2e-3, 4e-3]).interval)
    assert not whole.health
    assert set(pool([batches[0]], 0.01).health) == {"single_run"}


def test_estimates_that_cannot_be_pooled_leave_the_newest(estimate):
    one, two = estimate(LogNormal(1e-3, 0.04, 20)), estimate(interval_at=lambda c: (1e-4, 1e-2))
    whole = pool([one, two], 0.01)
    assert isinstance(derive_distribution(whole), Tabulated)
    assert whole.interval == (1e-4, 1e-2)
    assert whole.rollouts == 2000


def test_warnings_of_all_batches_count_and_errors_add_up(estimate):
    ill = estimate(Binomial(1, 100), health={"few_roots": "x", "errors": "20 of 1000"}, errors=20)
    well = estimate(Binomial(1, 100), errors=0)
    assert set(pool([ill, well], 0.01).health) == {"few_roots"}
    assert set(pool([well, ill, well], 0.005).health) == {"few_roots", "errors"}


def test_an_unchecked_batch_gives_way_to_a_newest_one_that_is_checked_and_agrees(estimate):
    unchecked, checked = (
        estimate(LogNormal(mean, 0.01, 20), health=health, unopened_at=opened)
        for mean, health, opened in (
            (1e-3, {"unchecked": "x"}, lambda _: (9e-4, 1.1e-3)),
            (1.02e-3, {}, None),
        )
    )
    whole = pool([unchecked, checked], 0.01)
    assert (derive_distribution(whole), whole.health) == (LogNormal(1.02e-3, 0.01, 20), {})
    assert whole.rollouts == 2000
    assert set(pool([checked, unchecked], 0.01).health) == {"unchecked"}
    for mean in (5e-4, 2e-3):
        other = estimate(LogNormal(mean, 0.01, 20))
        assert set(pool([unchecked, other], 0.01).health) == {"unchecked"}
    doubted = replace(unchecked, health={"unchecked": "x", "contradicted": "y"})
    assert set(pool([doubted, checked], 0.01).health) == {"unchecked", "contradicted"}


@pytest.mark.parametrize(
    ("outcomes", "kept"),
    [
        (("disagree", "agree", "inconclusive"), 0),
        (("agree", "agree", "inconclusive"), 1),
        (("inconclusive", "agree", "disagree"), 2),
        (("inconclusive", "inconclusive"), 1),
    ],
)
def test_the_gravest_cross_check_of_all_batches_stands_at_the_cost_of_all(estimate, outcomes, kept):
    checks = [
        CrossCheckResult(
            f"check {k}", outcome, 0.15, result=estimate(rollouts=10**k, simulated_steps=2 * 10**k)
        )
        for k, outcome in enumerate(outcomes)
    ]
    batches = [
        estimate(Binomial(2, 100), cross_check=check, notes=(Note("cross_check", check.estimator),))
        for check in checks
    ]
    whole = pool(batches, 0.01)
    assert whole.cross_check.estimator == f"check {kept}"
    assert whole.notes == (Note("cross_check", f"check {kept}"),)
    assert whole.cross_check.result.rollouts == sum(10**k for k in range(len(checks)))
    assert whole.cross_check.result.simulated_steps == 2 * whole.cross_check.result.rollouts


def test_pooled_batches_have_the_notes_of_the_newest_but_for_its_goal(estimate):
    first, last = (
        estimate(Binomial(2, 100), notes=(Note("goal", f"goal {k}"), Note("blind", f"blind {k}")))
        for k in range(2)
    )
    assert pool([first, last], 0.01).notes == (Note("blind", "blind 1"),)
