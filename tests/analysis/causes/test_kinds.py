"""Kinds of failure, on systems whose kinds and probabilities are known."""

import dataclasses
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest

import avrare
from avrare.analysis.causes.failure_sample import FailureSample, ModelInterval
from avrare.analysis.causes.kinds import describe_cause, find_kinds
from avrare.base.errors import UsageError
from avrare.base.number_format import describe_share
from avrare.estimation.combine.ensemble import combine
from avrare.estimation.result.result import Failures
from avrare.rollout.replay import replay_tapes
from avrare.testing.faulty_systems import Walk
from avrare.testing.static_problems import Static
from avrare.testing.walk_problems import walk

NORMAL = NormalDist()
LIMIT = 2.0
LIKELY = 1.0 - NORMAL.cdf(LIMIT)
RARE = LIKELY / 9.0
"""Two modes, 9 : 1."""


def two_modes():
    formula = f"always (u0 < {LIMIT} and u1 < {NORMAL.inv_cdf(1.0 - RARE)})"
    return avrare.Problem(Static(3), avrare.stl(formula), steps=0)


@pytest.fixture(scope="module")
def result():
    return avrare.estimate(two_modes(), rollouts=3500, seed=2)


def test_two_modes_are_found_with_their_shares(result):
    kinds = find_kinds(result)
    assert len(kinds) == 2
    for kind, truth in zip(kinds, (LIKELY, RARE), strict=True):
        low, high = kind.interval
        assert low < truth * (1.0 - RARE) < high
        assert low < kind.probability < high
    assert sum(kind.probability for kind in kinds) == pytest.approx(result.probability)
    assert sorted(k for kind in kinds for k in kind.members) == list(range(len(result.failures.robustness)))


def test_a_kind_is_told_by_what_is_violated_and_by_the_noise_that_does_it(result):
    likely, rare = find_kinds(result)
    assert likely.text.startswith("u0 < 2 is violated first")
    assert likely.cause.startswith("noise 0 +")
    assert "u1 <" in rare.text
    assert rare.cause.startswith("noise 1 +")
    assert "noise 2 " not in likely.cause + rare.cause
    tape = result.failures.noise[rare.representative, 0]
    assert tape[1] > 2.5


def test_kinds_with_the_same_violation_are_told_apart_by_a_signal():
    problem = avrare.Problem(Walk(scale=1.0), avrare.stl("always (abs(x) < 12)"), steps=20)
    kinds = find_kinds(avrare.estimate(problem, rollouts=4000, seed=1))
    assert len(kinds) == 2
    texts = [kind.text for kind in kinds]
    assert all(text.startswith("abs(x) < 12 is violated first") for text in texts)
    assert sorted("; x is -" in text for text in texts) == [False, True]
    assert all(" in the other kind)" in text for text in texts)
    assert sorted(" -" in kind.cause and "sigma in sum for" in kind.cause for kind in kinds) == [False, True]


def test_one_mode_is_one_kind():
    problem = avrare.Problem(Static(2), avrare.stl("always (u0 < 2)"), steps=0)
    kinds = find_kinds(avrare.estimate(problem, rollouts=2000, seed=0))
    assert len(kinds) == 1
    assert kinds[0].share == pytest.approx(1.0)
    assert kinds[0].probability == kinds.result.probability
    assert kinds[0].interval == kinds.result.interval


def test_the_table_and_the_text_name_every_kind(result):
    kinds = find_kinds(result)
    assert [row["kind"] for row in kinds.table()] == [1, 2]
    assert repr(kinds).splitlines()[0].startswith("specification: 2 kinds of failure, together 0.02")
    assert repr(kinds).splitlines()[0].endswith(")")


def test_the_text_says_how_many_failures_are_kept():
    problem = avrare.Problem(Static(1), avrare.stl("always (u0 < 1)"), steps=0)
    result = avrare.estimate(problem, rollouts=1000, seed=0)
    end = f", by the 100 of {result.failures.count:,} failures that are kept"
    assert repr(find_kinds(result)).splitlines()[0].endswith(end)


@pytest.mark.parametrize("estimator", ["ams", "ess", "is"])
def test_weighted_and_related_failures_add_up_to_the_estimate(estimator):
    few = {"ams": {"particles": 40, "discard": 10}, "ess": {"chains": 20}, "is": {}}
    options = few[estimator] | {"runs": 2}
    problem = walk(2.5).problem()
    result = avrare.estimate(problem, estimator, seed=1, **options)
    failures = result.failures
    assert failures.weights.sum() == pytest.approx(result.probability)
    kinds = find_kinds(result)
    assert sum(kind.probability for kind in kinds) == pytest.approx(result.probability)
    assert all(kind.interval[0] <= kind.probability <= kind.interval[1] for kind in kinds)


def test_a_kind_that_rests_on_one_ancestor_gets_a_warning():
    problem = two_modes()
    noise = np.zeros((8, 1, 3))
    noise[:6, 0, 0], noise[6:, 0, 1] = np.linspace(2.1, 2.4, 6), (4.0, 4.1)
    result = avrare.estimate(problem, rollouts=500, seed=0)
    ancestors = np.array(
        [[r, k] for r, k in [(0, 1), (0, 2), (1, 3), (1, 4), (2, 5), (2, 6), (0, 9), (0, 9)]]
    )
    failures = Failures(noise, -np.ones(8), 8, np.full(8, result.probability / 8), ancestors)
    splitting = dataclasses.replace(result, failures=failures, trials=0, run_probabilities=np.full(3, 0.02))
    likely, rare = find_kinds(splitting)
    assert not likely.warnings
    assert rare.ancestors == 1
    assert "rests on one first rollout" in rare.warnings[0]


def test_monte_carlo_that_stops_by_a_rule_has_wider_parts():
    stopped = avrare.estimate(two_modes(), relative_error=0.2, seed=2)
    assert FailureSample.of(stopped).trials == 0
    kinds = find_kinds(stopped)
    assert sum(kind.probability for kind in kinds) == pytest.approx(stopped.probability)


def test_without_failures_there_are_no_kinds():
    problem = avrare.Problem(Static(1), avrare.stl("always (u0 < 9)"), steps=0)
    with pytest.raises(UsageError, match="no failure is kept"):
        find_kinds(avrare.estimate(problem, rollouts=10))


def test_a_result_of_another_process_says_so(result):
    with pytest.raises(UsageError, match="does not know its problem"):
        find_kinds(dataclasses.replace(result, origin=None))


def test_hdbscan_finds_the_modes_too(result):
    kinds = find_kinds(result, method="hdbscan")
    assert len(kinds) >= 2
    assert sum(kind.probability for kind in kinds) == pytest.approx(result.probability)


@pytest.mark.slow
def test_the_intervals_of_the_kinds_cover_their_probabilities():
    problem, truths, covered = two_modes(), (LIKELY * (1.0 - RARE), RARE * (1.0 - LIKELY)), 0
    for seed in range(60):
        kinds = find_kinds(avrare.estimate(problem, rollouts=3500, seed=100 + seed))
        assert len(kinds) == 2
        covered += sum(k.interval[0] <= p <= k.interval[1] for k, p in zip(kinds, truths, strict=True))
    assert covered >= 108  # of 120; 95 % intervals that cover less often than 0.95 would fall below


def sample_of(noise, weights=None, ancestors=None, runs=1, trials=0):
    failures = Failures(noise, np.zeros(len(noise)), len(noise), weights, ancestors)
    return FailureSample(failures, 0.01, 0.1, trials, runs, 0, 0.95)


def test_a_share_of_alike_failures_has_the_exact_binomial_interval():
    chosen = np.arange(40) < 10
    share, (low, high) = sample_of(np.zeros((40, 1, 1)), trials=4000).share_interval(chosen)
    assert share == 0.25
    assert (low, high) == pytest.approx((0.1269, 0.4120), abs=1e-4)


def test_noise_of_copies_tells_as_much_as_that_of_their_ancestors():
    # 64 failures of four first rollouts, or of four runs: channel 1 is 1 sigma in all, 2 standard errors.
    noise = np.tile(np.array([0.0, 1.0, 0.0]), (64, 1, 1))
    noise[:, 0, [0, 2]] = np.tile([[1.0, -1.0], [-1.0, 1.0]], (32, 1))
    weights, families = np.full(64, 0.01 / 64), np.repeat(np.arange(4), 16)
    ancestors = np.stack([np.zeros(64, dtype=int), families], axis=1)
    chosen = np.ones(64, dtype=bool)
    rollouts = replay_tapes(two_modes(), noise)
    cause = describe_cause(two_modes(), sample_of(noise, weights), chosen, rollouts)
    assert cause == "noise 1 +1 sigma at step 0"
    assert describe_cause(two_modes(), sample_of(noise, weights, ancestors), chosen, rollouts) == ""
    of_runs = np.stack([families, np.arange(64)], axis=1)
    assert describe_cause(two_modes(), sample_of(noise, weights, of_runs, runs=4), chosen, rollouts) == ""


@pytest.mark.parametrize(
    ("share", "text"),
    [(1.0, "100 %"), (0.954, "95 %"), (0.0042, "0.4 %"), (0.0001, "under 0.1 %"), (0.0, "0 %")],
)
def test_shares_in_words(share, text):
    assert describe_share(share) == text


def test_parts_of_an_estimate_over_an_ensemble_have_the_share_of_the_model():
    whole = ModelInterval((0.002, 0.05), 0.95, 8)
    alone = sample_of(np.zeros((40, 1, 1)), trials=4000)
    sample, chosen = replace(alone, trials=0, model=whole), np.arange(40) < 10
    assert sample.part_interval(np.ones(40, dtype=bool)) == (0.01, pytest.approx((0.002, 0.05)))
    part, (low, high) = sample.part_interval(chosen)
    assert part == pytest.approx(0.0025)
    assert low < 0.25 * 0.002  # the error of the share comes on top
    assert high > 0.25 * 0.05
    narrow = alone.part_interval(chosen)[1]
    assert low < narrow[0]
    assert high > narrow[1]
    surer = replace(sample, confidence=0.99).part_interval(np.ones(40, dtype=bool))[1]
    assert surer[0] < 0.002
    assert surer[1] > 0.05


def test_errors_of_a_pilot_leave_an_upper_end():
    sample = replace(sample_of(np.zeros((40, 1, 1)), trials=42), errors=5)
    assert sample.part_interval(np.ones(40, dtype=bool))[1][1] == 1.0
    assert sample.part_interval(np.arange(40) < 10)[1][1] < 0.6


def test_the_interval_over_an_ensemble_is_that_of_all_failures(result):
    fresh = {k: replace(result, probability=result.probability * f) for k, f in enumerate((0.5, 1.0, 2.0))}
    over = combine(result, 3, None, fresh)
    sample = FailureSample.of(over)
    assert sample.part_interval(np.ones(sample.size, dtype=bool))[1] == pytest.approx(over.interval)
    assert find_kinds(over)[0].interval[1] > find_kinds(result)[0].interval[1]
