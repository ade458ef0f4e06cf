"""Splitting's contracts: cost, replay, intervals, health, errors, edge cases."""

import json
import math

import numpy as np
import pytest
from scipy import stats

import avrare
import odd_systems
from avrare.estimation.result.doubts import undo_opening
from avrare.estimation.result.intervals import clopper_pearson
from avrare.testing import faulty_systems as systems
from avrare.testing.problems import count_down, reference_problem
from avrare.testing.walk_problems import Lag

RARE_WALK = reference_problem("d_rw_L3.8")


def walk(limit=1.5, system=None, steps=40, score=None, **keywords):
    system = system or systems.Walk()
    return avrare.Problem(system, avrare.stl(f"always (x < {limit})"), steps, score, **keywords)


def estimate(problem, seed=0, particles=40, discard=8, runs=4, **keywords):
    return avrare.estimate(
        problem, "ams", seed=seed, particles=particles, discard=discard, runs=runs, **keywords
    )


def test_counters_count_each_step_once():
    result = estimate(walk(system=odd_systems.Odometer()))
    assert result.counts == {"steps": result.simulated_steps}


@pytest.mark.parametrize("score", [odd_systems.backwards, Lag(0.1)])
def test_discarded_failures_are_not_lost(score):
    """Count failures that a score puts below other particles, and keep their tapes."""
    task = walk(0.4, steps=6, score=score)
    result = estimate(task, particles=20, discard=5, runs=10)
    failures = result.failures
    assert result.probability > 0.0
    assert len(failures.robustness) > 0
    np.testing.assert_array_equal(task.robustness(failures.noise), failures.robustness)
    assert task.replay(failures.noise).violated.all()
    assert result.worst.robustness <= failures.robustness.min()
    assert task.robustness(result.worst.noise[None])[0] == result.worst.robustness


def scatter_interval(result):
    """Return the interval by the scatter of the runs, before doubts opened it."""
    return undo_opening(result).interval


def join_roots(result, ends):
    """Return an interval with the exact one of the roots, if those are few."""
    if "few_roots" not in result.health:
        return tuple(ends)
    roots, particles = sum(result.diagnostics["roots"]), result.diagnostics["full_rollouts"]
    counted = np.array(clopper_pearson(roots, particles, 0.95)) * result.probability * particles / roots
    return min(ends[0], counted[0]), max(ends[1], counted[1])


def test_interval_joins_t_delta_log_and_cox_where_no_run_is_0():
    result = estimate(walk(), runs=6, confidence=0.9)
    values = result.run_probabilities
    relative = values.std(ddof=1) / np.sqrt(6) / values.mean()
    width = math.sqrt(math.log1p(relative**2))
    logs = np.log(values)
    spread = logs.var(ddof=1)
    both = [
        [math.log(values.mean()), width],
        [logs.mean() + spread / 2, math.sqrt(spread / 6 + spread**2 / 10)],
    ]
    ends = np.exp([[centre - t * x, centre + t * x] for t in [stats.t.ppf(0.95, 5)] for centre, x in both])
    assert scatter_interval(result) == pytest.approx((ends[:, 0].min(), ends[:, 1].max()), rel=1e-9)
    assert result.relative_error == pytest.approx(relative)


def test_a_run_of_0_leaves_t_delta_log():
    result = next(
        one
        for seed in range(20)
        for one in [estimate(walk(2.5), seed, particles=10, discard=4)]
        if one.probability and not one.run_probabilities.all()
    )
    values = result.run_probabilities
    relative = values.var(ddof=1) / 4 / values.mean() ** 2
    factor = stats.t.ppf(0.975, 3) * math.sqrt(math.log1p(relative))
    expected = join_roots(result, values.mean() * np.exp([-factor, factor]))
    assert scatter_interval(result) == pytest.approx(expected, rel=1e-9)


def test_interval_of_a_single_run_uses_its_genealogy():
    result = estimate(walk(), runs=1)
    relative = math.sqrt(result.diagnostics["genealogical_variance"][0]) / result.probability
    factor = 1.959963984540054 * math.sqrt(math.log1p(relative**2))
    expected = result.probability * np.exp([-factor, factor])
    assert scatter_interval(result) == pytest.approx(join_roots(result, expected), rel=1e-9)
    assert result.relative_error == pytest.approx(relative)
    assert "single_run" in result.health


def test_interval_is_never_a_point():
    """Keep a width also where the unbiased estimate of a single run's variance falls below zero."""
    met = 0
    for seed in range(30):
        result = estimate(walk(0.3, steps=10), seed, particles=4, discard=1, runs=1)
        low, high = result.interval
        assert 0.0 <= low <= result.probability <= high <= 1.0
        assert low < high
        if result.probability and result.diagnostics["genealogical_variance"][0] <= 0:
            met += any(result.diagnostics["stages"])
    assert met, "no such run was met: the test shows nothing"


@pytest.mark.parametrize("runs", [1, 5])
def test_extinction(runs):
    result = estimate(walk(50.0, steps=5), particles=5, discard=4, runs=runs)
    assert result.probability == 0.0
    assert result.interval == clopper_pearson(0, 5 * runs, 0.95)
    assert result.interval_at(0.5) == clopper_pearson(0, 5 * runs, 0.5)
    assert set(result.health) == {"extinct"} | ({"single_run"} if runs == 1 else set())
    assert result.run_probabilities.tolist() == [0.0] * runs
    assert result.failures.noise.shape == (0, 6, 1)
    assert json.loads(result.to_json())["relative_error"] is None


@pytest.mark.parametrize("limit", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("runs", [1, 2, 5])
def test_frequent_failures(limit, runs):
    for seed in range(10):
        result = estimate(walk(limit, steps=10), seed, particles=10, discard=1, runs=runs)
        low, high = result.interval
        assert math.isfinite(low)
        assert 0.0 <= low <= result.probability <= high <= 1.0


def test_static_problem_is_monte_carlo():
    class Static(systems.Walk):
        def initial(self, noise):
            return {"x": noise[:, 0]}

    task = avrare.Problem(Static(), avrare.stl("always (x < 1)"), 0)
    result = estimate(task, runs=5)
    assert result.rollouts == 200
    assert result.probability == pytest.approx(result.failures.count / 200)
    same = avrare.estimate(task, rollouts=40, runs=5)
    np.testing.assert_array_equal(result.run_probabilities, same.run_probabilities)
    assert result.interval == same.interval
    rare = avrare.Problem(Static(), avrare.stl("always (x < 9)"), 0)
    assert "nothing to branch from" in estimate(rare, runs=5).health["extinct"]


def test_health_of_runs_with_few_particles():
    result = estimate(RARE_WALK.problem(), particles=10, discard=5, runs=10, seed=1)
    assert {"extinct", "few_roots"} & set(result.health)
    assert all(isinstance(text, str) and "{" not in text for text in result.health.values())


def test_a_run_may_end_below_the_floor():
    result = estimate(walk(50.0), floor=1e-3)
    assert result.probability < 1e-3
    assert max(result.diagnostics["stages"]) < 60


def test_errored_particles_are_never_parents():
    """Break rows that jump at step 1 down at step 2. A child of such a row would too, others cannot."""

    class Jump(systems.Walk):
        def step(self, state, noise):
            first = state["x"] == 0.0
            x = np.where(first & (noise[:, 0] > 0.5), 3.0, state["x"] + 0.1 * noise[:, 0])
            return {"x": np.where(state["x"] >= 3.0, np.nan, x)}

    result = estimate(walk(9.0, system=Jump(), steps=6))
    broken = np.isnan(result.robustness).sum()
    assert 20 < broken < 80
    assert result.rollouts > 300
    assert result.errors == broken


def test_errors_on_the_way_to_failure_are_not_failures():
    task = walk(1.5, system=odd_systems.Doomed(1.0))
    result = estimate(task, particles=60, discard=6, runs=5)
    healthy = estimate(walk(1.5), particles=60, discard=6, runs=5)
    assert result.errors > 0
    assert result.probability < 0.2 * healthy.probability
    assert "errors" in result.health
    assert result.interval[1] > healthy.probability, "the upper bound counts errors as failures"


def test_errors_enter_the_upper_bound_even_when_they_are_discarded():
    """Break rows down at t = 0: they have the least score and go first, but they might have failed."""
    result = estimate(walk(system=systems.Fragile.with_chance(0.3, at_start=True)), runs=10)
    share = np.isnan(result.robustness).mean()
    assert 0.2 < share < 0.4
    assert share < result.interval[1] < share + 0.1


def test_infinite_scores():
    class Far(systems.Walk):
        def step(self, state, noise):
            return {"x": np.where(noise[:, 0] > 1.0, np.inf, state["x"] + 0.1 * noise[:, 0])}

    result = estimate(walk(system=Far(), steps=2), runs=50)
    truth = 1 - 0.8413447460685429**2
    assert abs(result.probability - truth) < 4 * truth * result.relative_error
    assert np.isneginf(result.failures.robustness).all()


def test_diagnostics_are_json_and_complete():
    result = estimate(walk())
    entry = json.loads(result.to_json())["diagnostics"]
    lists = {"stages", "levels", "discarded", "roots", "genealogical_variance"}
    assert set(entry) == lists | {"extinct_runs", "full_rollouts", "branched_rollouts"}
    assert all(len(entry[name]) == 4 for name in entry if isinstance(entry[name], list))
    assert all(1 <= roots <= 40 for roots in entry["roots"])


def test_progress_shows_levels():
    seen = []
    result = estimate(walk(chunk=16), runs=2, progress=seen.append)
    rollouts = [info.rollouts for info in seen]
    assert rollouts == sorted(rollouts)
    assert rollouts[-1] == result.rollouts
    assert seen[-1].probability == result.probability
    levels = [info.level for info in seen if info.level is not None]
    assert len(levels) > 3
    assert levels[-1] <= 0.0 < seen[-1].stage


@pytest.mark.slow
def test_equal_runs_give_neither_certainty_nor_a_warning():
    tries = (estimate(walk(steps=100), seed, particles=20, discard=2, runs=2) for seed in range(100, 150))
    result = next(r for r in tries if r.run_probabilities[0] == r.run_probabilities[1])
    low, high = result.interval
    assert low < result.probability < high
    assert "all_failed" not in result.health


def test_the_published_variant_discards_one_more_and_counts_robustness_zero():
    kept, published = (estimate(walk(), discard=4, variant=variant) for variant in ("unbiased", "published"))
    least = [min(k for run in r.diagnostics["discarded"] for k in run) for r in (kept, published)]
    assert least == [4, 5]
    assert (kept.relation, published.relation) == ("violated", "robustness <= 0")
    assert published.diagnostics["full_rollouts"] == 160
    assert published.diagnostics["branched_rollouts"] == published.rollouts - 160
    touching = avrare.Problem(systems.Walk(scale=0.0), avrare.stl("always (x <= 0)"), steps=3)
    assert avrare.estimate(touching, "ams", particles=5, discard=1).probability == 0.0
    assert avrare.estimate(touching, "ams", particles=5, discard=1, variant="published").probability == 1.0


@pytest.mark.slow
def test_the_published_variant_is_unbiased_where_robustness_only_falls():
    walk, truth = reference_problem("d_rw_L2.5").problem(), reference_problem("d_rw_L2.5").probability
    values = estimate(walk, particles=50, discard=5, runs=200, variant="published").run_probabilities
    assert abs(values.mean() - truth) < 4 * values.std(ddof=1) / np.sqrt(len(values)) < truth


@pytest.mark.slow
def test_the_published_variant_loses_failures_where_robustness_recovers():
    reference = reference_problem("g_eventually_c0.5")
    task, options = reference.problem(score="robustness"), {"runs": 20, "variant": "published"}
    values = estimate(task, particles=100, discard=10, **options).run_probabilities
    assert values.mean() < 0.2 * reference.probability


@pytest.mark.slow
def test_ties_give_a_note():
    result = estimate(count_down(4, 9, "1/5").problem(), particles=50, discard=2, runs=10)
    assert "ties" in [note.kind for note in result.notes]
    assert "ties" not in result.health
    smooth = estimate(reference_problem("d_rw_L2.5").problem(), particles=100, discard=10, runs=10)
    assert "ties" not in [note.kind for note in smooth.notes]
