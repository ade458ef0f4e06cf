"""A climb: its entry level, its route, and groups that are unbiased whatever they were told."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from interruptions import estimate_through_interruptions
from outlier_systems import outliers
from scipy.stats import chi2

import avrare
from avrare.base.errors import UsageError
from avrare_estimators.common.lessons.lessons import LEAST_ELITE, Lessons
from avrare_estimators.common.lessons.stored_proposal import FILE
from avrare_estimators.common.samples.groups import Groups
from avrare_estimators.common.samples.sampling import Sample
from avrare_estimators.common.samples.sources import Stratum, TapeSource
from avrare_estimators.importance import climbing_sampling, learned_sampling
from avrare_estimators.importance.entry import LENGTH, Entry, best_entry, start_variance
from avrare_estimators.importance.proposal_file import ProposalFile
from avrare_estimators.importance.route import Route

LIMIT = 62.0
P = float(chi2.sf(LIMIT, 24))
QUICK = {"pilot": 600, "relative_error": 0.25, "rollouts": 100_000, "climb": True}


def energetic():
    """Return a problem whose failures need no noise in particular, and have a probability of 3e-5."""
    return outliers(f"always (energy < {LIMIT})")


def estimate(seed=0, **options):
    return avrare.estimate(energetic(), "is", seed=seed, **{**QUICK, **options})


@pytest.fixture(scope="module")
def climbed():
    return [estimate(seed) for seed in range(8)]


def test_a_climb_is_unbiased_and_its_interval_holds_the_truth(climbed):
    assert all("climb" in one.diagnostics for one in climbed)
    found = np.array([one.probability for one in climbed]) / P
    assert abs(found.mean() - 1.0) < 3.5 * found.std(ddof=1) / math.sqrt(len(found))
    assert sum(one.interval[0] <= P <= one.interval[1] for one in climbed) == 8
    assert np.median([one.rollouts for one in climbed]) < 0.1 * (1.0 / P / 0.25**2)


def test_a_climb_says_what_it_did_and_what_it_cost(climbed):
    one = climbed[0]
    told = one.diagnostics["climb"][0]
    assert P < told["entered"] < 0.1
    assert len(told["roots"]) == told["groups"] >= 12
    rows = sum(one.diagnostics["rows"])
    checked = one.diagnostics["check_rollouts"]
    assert one.rollouts == one.diagnostics["learning_rollouts"] + rows + told["rollouts"] + checked
    assert "Markov chains climb" in {note.kind: note.text for note in one.notes}["climb"]
    assert one.diagnostics["goal_reached"] == (one.relative_error <= 0.25)


def test_a_pilot_promises_what_the_groups_cost(climbed):
    ratios = []
    for one in climbed:
        route = Route.from_dict(one.artifacts[FILE]["climb"], None) if FILE in one.artifacts else None
        if route is not None:
            spent = sum(one.diagnostics["rows"]) + one.diagnostics["climb"][0]["rollouts"]
            ratios.append(one.relative_error**2 * spent / route.cost())
    assert len(ratios) >= 6
    assert 0.5 < np.median(ratios) < 2.0


def test_learning_goes_on_while_a_climb_gets_cheaper(monkeypatch):
    monkeypatch.setattr(learned_sampling, "gain_nothing", lambda stages: True)
    assert len(estimate(climb=False, rollouts=5000).diagnostics["stages"][0]) == 1
    assert len(estimate().diagnostics["stages"][0]) > 1


def test_failures_of_a_climb_fail_again_and_add_up_to_the_estimate(climbed):
    one = climbed[0]
    again = energetic().replay(one.failures.noise)
    assert len(one.failures.noise) > 20
    assert again.violated[:, 0].all()
    np.testing.assert_allclose(again.robustness[:, 0], one.failures.robustness)
    assert one.failures.weights.sum() == pytest.approx(one.probability)
    assert one.worst.robustness <= one.failures.robustness.min()


def test_a_climb_has_the_same_bits_in_small_batches_and_small_chunks(climbed, monkeypatch):
    monkeypatch.setattr(climbing_sampling.ClimbingSampling, "_most_chains", lambda self, state: 100)
    other = avrare.estimate(outliers(f"always (energy < {LIMIT})", chunk=37), "is", seed=0, **QUICK)
    assert other.probability == climbed[0].probability
    assert other.interval == climbed[0].interval
    assert other.diagnostics == climbed[0].diagnostics
    np.testing.assert_array_equal(other.failures.noise, climbed[0].failures.noise)
    np.testing.assert_array_equal(other.failures.weights, climbed[0].failures.weights)


def test_a_climb_goes_on_after_interruptions(climbed, tmp_path):
    def run(problem):
        return avrare.estimate(problem, "is", seed=0, checkpoint=tmp_path / "state", **QUICK)

    found, interruptions = estimate_through_interruptions(energetic, run, 100, 100)
    assert interruptions >= 3
    assert found.probability == climbed[0].probability
    assert found.rollouts == climbed[0].rollouts


def test_a_learned_file_has_the_route_and_saves_the_way_to_it(climbed, tmp_path):
    first = next(one for one in climbed if FILE in one.artifacts)
    path = tmp_path / FILE
    path.write_text(json.dumps({"specification": first.artifacts[FILE]}))
    reused = [
        avrare.estimate(energetic(), "is", seed=s, learned=str(path), relative_error=0.25) for s in range(4)
    ]
    assert all(one.diagnostics["learning_rollouts"] == 0 and "climb" in one.diagnostics for one in reused)
    assert np.mean([one.probability for one in reused]) == pytest.approx(P, rel=0.5)
    (route,) = ProposalFile.read(path).routes.values()
    assert route.to_dict() == first.artifacts[FILE]["climb"]


@pytest.mark.parametrize(
    "change", [{"levels": []}, {"angles": [0.0]}, {"probability": 2.0}, {"variance": "?"}, {"reached": None}]
)
def test_a_damaged_route_is_refused(change):
    whole = a_route().to_dict()
    assert Route.from_dict(whole, None) == a_route()
    with pytest.raises(UsageError, match="climb of a learned proposal is damaged"):
        Route.from_dict({**whole, **change}, None)


def a_route(variance=90.0, lasting=6.0, chance=10.0):
    return Route(Entry(-1.0, 1e-3, variance, None), (-1.0, -0.5), (0.2, 0.1), lasting, chance, 1e-5)


def test_groups_divide_the_work_as_their_variances_ask():
    route = a_route()
    size = route.sized(0.05, 1e9, 10**6)
    moves = size.levels * size.chains * (LENGTH - 1)
    assert size.cost == size.rows + moves
    # The best division: rows over moves is the ratio of the roots of variance per unit of either.
    starts, chains = start_variance(90.0, 6.0), 10.0 / size.chains
    assert size.rows / moves == pytest.approx(math.sqrt(starts / (chains * moves)), rel=0.05)
    variance = starts / size.rows + chains
    assert size.first == pytest.approx(variance / 0.05**2 / 2.0, rel=0.1)
    assert size.first * size.cost == pytest.approx(route.cost() / 0.05**2 / 2.0, rel=0.1)
    assert route.sized(0.05, 1e9, 30).chains == 30
    small = route.sized(0.5, 1e9, 10**6)
    assert (small.chains, small.first) == (20, 12)


def test_the_groups_of_two_batches_are_pooled():
    one, two = (Groups(np.array(v), np.array(v), (1,) * len(v), np.array(v), 10) for v in ([1.0, 3.0], [5.0]))
    both = one + two
    assert both.mean == 3.0
    assert both.variance(3.0) == pytest.approx(4.0 / 9.0 / 3.0)
    assert (both.roots, both.rollouts) == ((1, 1, 1), 20)


def lessons(score, violated):
    n = len(score)
    strata = (Stratum(None, 0, 0, n, True), Stratum(None, 0, 0, 0, False))
    zeros = np.zeros(n)
    sample = Sample(TapeSource(None), strata, zeros, violated, violated & False, zeros, score, ())
    return Lessons(0.25).add(sample)


def test_the_cost_of_a_climb_from_failure_itself_is_that_of_its_sample():
    entry = Entry(math.inf, 1e-3, 90.0, None)
    assert entry.cost(1e-3) == pytest.approx(90.0)
    assert entry.cost(1e-4) > 2.0 * 90.0


def test_an_entry_lies_where_the_sum_of_sample_and_chains_is_least():
    score = np.random.default_rng(0).permutation(np.arange(10_000.0))
    known = lessons(score, score > 9_980.0)
    entry = best_entry(known)
    assert entry.climbs
    assert (score > entry.level).mean() == pytest.approx(entry.probability)
    assert entry.variance == pytest.approx(1.0 / entry.probability - 1.0)
    others = [Entry(0.0, p, 1.0 / p - 1.0, None) for p in (0.3, 0.1, 0.05, 0.03, 0.01)]
    assert entry.cost(2e-3) < 1.01 * min(one.cost(2e-3) for one in others)


def test_failures_that_are_frequent_are_sampled_without_chains():
    score = np.random.default_rng(1).permutation(np.arange(10_000.0))
    entry = best_entry(lessons(score, score >= 9_000.0))
    assert not entry.climbs
    assert entry.probability == pytest.approx(0.1)


def test_levels_above_which_few_rows_are_known_are_no_entries():
    score = np.arange(200.0)
    entry = best_entry(lessons(score, score > 198.0))
    assert entry.probability * 200 >= LEAST_ELITE
    assert best_entry(lessons(score[:50], score[:50] > 48.0)) is None


def test_a_group_of_which_no_row_enters_counts_as_zero(climbed, monkeypatch):
    original = climbing_sampling.Route.sized

    def tiny(*arguments):
        return replace(original(*arguments), rows=8)

    monkeypatch.setattr(climbing_sampling.Route, "sized", tiny)
    found = estimate(1)
    assert 0 in found.diagnostics["climb"][0]["roots"]
    assert "extinct_runs" in found.health or "extinct" in found.health
    assert found.interval[0] <= P <= found.interval[1]


class Fragile:
    """The system of outliers, whose rollouts break down at one energy in some hundred."""

    def __init__(self):
        self.whole = energetic().system
        self.noise_size = self.whole.noise_size

    def initial(self, noise):
        return self.whole.initial(noise)

    def step(self, state, noise):
        return self.whole.step(state, noise)

    def signals(self, state):
        signals = self.whole.signals(state)
        broken = (signals["energy"] > 40.0) & (signals["energy"] * 97.0 % 1.0 < 0.2)
        return {**signals, "energy": np.where(broken, np.nan, signals["energy"])}


def test_rollouts_that_break_down_are_counted_and_raise_the_upper_end(climbed):
    problem = avrare.Problem(Fragile(), avrare.stl(f"always (energy < {LIMIT})"), 8)
    found = avrare.estimate(problem, "is", seed=0, **QUICK)
    assert "climb" in found.diagnostics
    assert found.errors > 100
    # Failures lost to breakdowns may be all of the rollouts that broke down above the entry level.
    assert found.interval[1] > 1.5 * climbed[0].interval[1]
    assert found.interval[0] < P < found.interval[1]


def test_there_is_no_climb_where_its_chains_do_not_fit_into_memory(monkeypatch):
    monkeypatch.setattr(climbing_sampling, "chain_bytes", lambda plan: 2**29)
    found = estimate(rollouts=20_000)
    assert "climb" not in found.diagnostics
    assert found.rollouts <= 20_000


def test_more_runs_than_chains_have_addresses_for_are_refused():
    with pytest.raises(UsageError, match="climb takes at most 16 runs"):
        avrare.estimate(energetic(), "is", climb=True, runs=17)


def test_several_runs_climb_each_by_its_own_route():
    found = avrare.estimate(energetic(), "is", climb=True, runs=3, rollouts=45000, pilot=600)
    assert len(found.diagnostics["climb"]) == 3
    assert len({one["level"] for one in found.diagnostics["climb"]}) == 3
    chains = sum(one["rollouts"] for one in found.diagnostics["climb"])
    told = found.diagnostics
    assert found.rollouts == told["learning_rollouts"] + sum(told["rows"]) + chains + told["check_rollouts"]
    assert found.interval[0] <= P <= found.interval[1]
    assert found.failures.weights.sum() == pytest.approx(found.probability)
