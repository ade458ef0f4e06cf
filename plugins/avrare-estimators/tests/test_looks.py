"""Pilots that raise the size of runs, and looks at which an estimate stops at a relative error."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import avrare
from avrare.estimation.result.doubts import undo_opening
from avrare.testing import faulty_systems as systems
from avrare.testing.problems import walk
from avrare_estimators.ams.config import AmsConfig
from avrare_estimators.common import health
from avrare_estimators.common.looks import Looks, Pilot
from avrare_estimators.ess.config import EssConfig
from benchmarks.studies.run_intervals import interval_of_runs
from estimates import estimate_through_kills, plain

SHORT = walk(0.9, 10)
SMALL = {"ams": {"particles": 20, "discard": 4}, "ess": {"chains": 6, "level_probability": 0.2}}
SIZE = {"ams": "particles", "ess": "chains"}


def problem(limit=0.9, lives=None, chunk=64):
    system = systems.Mortal(systems.Walk(), lives) if lives else systems.Walk()
    return avrare.Problem(system, avrare.stl(f"always (x < {limit})"), 20, chunk=chunk)


def estimate(name, limit=0.9, **options):
    return avrare.estimate(problem(limit), name, seed=3, **{**SMALL[name], **options})


def relative_error(values, done):
    values = values[:done]
    return values.std(ddof=1) / values.mean() / math.sqrt(len(values))


@pytest.mark.parametrize(
    ("goal", "first", "most", "runs"),
    [
        (None, 10, 10, (10,)),
        (0.1, 10, 320, (10, 20, 40, 80, 160, 320)),
        (0.1, 50, 320, (80, 160, 320)),
        (0.1, 10, 23, (12, 23)),
        (0.1, 10, 19, (19,)),
        (0.1, 10, 3, (3,)),
    ],
)
def test_looks_double_up_to_the_cap(goal, first, most, runs):
    looks = Looks.until(goal, first, most)
    assert looks.runs == runs
    assert sum(looks.share(done) for done in runs) == 1.0


def test_runs_are_added_up_to_the_look_at_which_the_goal_is_reached():
    looks = Looks.until(0.1, 10, 40)
    assert looks.missing(0, lambda: math.nan) == 10
    assert looks.missing(4, lambda: 0.01) == 6  # no look in between
    assert looks.missing(10, lambda: 0.11) == 10
    assert looks.missing(20, lambda: math.nan) == 20  # no failure so far
    assert looks.missing(20, lambda: 0.1) == 0
    assert looks.missing(40, lambda: 0.5) == 0


def test_looks_keep_the_confidence_where_a_single_interval_does_not():
    """Stop at runs that look quiet because they have missed their tail, which selects low estimates."""
    rng, looks = np.random.default_rng(1), Looks.until(0.2, 10, 80)
    held = {"paid": 0, "unpaid": 0}
    for _ in range(800):
        values, done = np.exp(0.8 * rng.standard_normal(80) - 0.32), 10
        while more := looks.missing(done, partial(relative_error, values, done)):
            done += more
        single = interval_of_runs(values[:done], 250)
        for name, at in (("paid", looks.interval(done, single)), ("unpaid", single)):
            low, high = at(0.9)
            held[name] += low <= 1.0 <= high
    error = math.sqrt(0.09 / 800)
    assert held["paid"] / 800 > 0.9 - 2 * error
    assert held["unpaid"] < held["paid"]


@pytest.mark.parametrize(("roots", "growth"), [(2, 8), (3, 8), (10, 3), (14, 2), (20, 2), (24, 1), (90, 1)])
def test_growth_aims_at_twenty_four_roots(roots, growth):
    assert Pilot(0, roots, math.nan).wanted_growth == growth


@pytest.mark.parametrize("roots", [0, 1, 1.8])
def test_growth_is_bounded_where_few_roots_are_expected_anyway(roots):
    pilot = Pilot(0, roots, math.nan)
    assert pilot.wanted_growth == 2
    (note,) = replace(pilot, growth=2).notes(500, "particles")
    assert "were not raised further" in note.text
    assert not replace(pilot, growth=1).notes(250, "particles")  # the budget paid for no more


def test_the_first_look_is_half_of_what_the_pilot_suggests():
    assert Pilot(0, 5, 0.8, growth=4).first_look(0.05, 10, 320) == 40
    assert Pilot(0, 5, 0.8, growth=4).first_look(0.5, 10, 320) == 10
    assert Pilot(0, 5, 0.8).first_look(0.01, 10, 320) == 320
    assert Pilot(0, 0, math.nan).first_look(0.01, 10, 320) == 10


@pytest.mark.parametrize("roots", [14, 15])
def test_few_roots_are_fewer_than_fifteen_in_all_runs_together(roots):
    assert ("few_roots" in health.check_runs([1e-3, 2e-3, 3e-3], [roots - 2, 1, 1])) == (roots < 15)


@pytest.mark.parametrize("extinct", [2, 3])
def test_runs_of_which_most_died_out_have_few_roots(extinct):
    values = [1e-3] * (5 - extinct) + [0.0] * extinct
    found = health.check_runs(values, [100 * bool(value) for value in values])
    assert ("few_roots" in found) == (extinct == 3)


@pytest.mark.parametrize(
    ("config", "grows"),
    [
        (AmsConfig(), True),
        (AmsConfig(runs=20), True),
        (AmsConfig(particles=250), False),
        (AmsConfig(particles=100, grow=True), True),
        (AmsConfig(grow=False), False),
        (AmsConfig(variant="published"), False),
        (EssConfig(), True),
        (EssConfig(chains=50), False),
        (EssConfig(second_pass=False), False),
    ],
)
def test_a_given_size_is_kept(config, grows):
    assert config.grows is grows
    again = type(config)(**config.model_dump())  # a run folder holds all defaults
    assert again.grows is grows
    assert again.model_dump() == config.model_dump()
    assert "grow" not in config.model_dump(exclude_unset=True) or "grow" in config.model_fields_set


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"grow": True, "variant": "published"}, "has none"),
        ({"relative_error": 0.2, "runs": 4}, "needs 5 to most_runs (320) runs"),
        ({"relative_error": 0.2, "most_runs": 8}, "needs 5 to most_runs (8) runs"),
    ],
)
def test_options_that_contradict_each_other(options, told):
    with pytest.raises(avrare.UsageError) as caught:
        avrare.estimate(problem(), "ams", **options)
    assert told in str(caught.value)


@pytest.mark.parametrize(("name", "goal"), [("ams", 0.12), ("ess", 0.2)])
def test_a_stopped_estimate_has_the_runs_of_one_of_fixed_size(name, goal):
    stopped = estimate(name, relative_error=goal, runs=5, most_runs=40)
    runs = len(stopped.run_probabilities)
    assert runs in (10, 20)
    assert stopped.relative_error <= goal
    assert stopped.diagnostics["goal_reached"] is True
    fixed = estimate(name, runs=runs)
    np.testing.assert_array_equal(stopped.run_probabilities, fixed.run_probabilities)
    assert (stopped.rollouts, stopped.simulated_steps) == (fixed.rollouts, fixed.simulated_steps)
    assert all(stopped.diagnostics[name] == fixed.diagnostics[name] for name in ("levels", "roots"))
    np.testing.assert_array_equal(stopped.failures.noise, fixed.failures.noise)
    np.testing.assert_array_equal(stopped.worst.noise, fixed.worst.noise)
    share = Looks(tuple(stopped.diagnostics["looks"]), goal).share(runs)
    assert share < 1.0
    assert undo_opening(stopped).interval == undo_opening(fixed).interval_at(1.0 - share * 0.05)


@pytest.mark.parametrize("name", SMALL)
def test_failures_of_later_batches_replay(name):
    rare = estimate(name, 1.4, relative_error=0.05, runs=5, most_runs=20)
    assert len(rare.run_probabilities) == 20
    assert rare.diagnostics["goal_reached"] is False
    np.testing.assert_array_equal(problem(1.4).robustness(rare.failures.noise), rare.failures.robustness)
    assert problem(1.4).replay(rare.failures.noise).violated.all()
    text = {note.kind: note.text for note in rare.notes}["goal"]
    assert "before it reached" in text
    assert "most_runs" in text


@pytest.mark.parametrize("name", SMALL)
def test_a_pilot_raises_the_size_and_does_not_count(name):
    grown = estimate(name, grow=True)
    told, size = grown.diagnostics, SIZE[name]
    assert told[size] > SMALL[name][size]
    assert told[size] % SMALL[name][size] == 0
    growth = told[size] // SMALL[name][size]
    given = {key: value * growth for key, value in SMALL[name].items() if isinstance(value, int)}
    if name == "ess":
        given["pilot"] = 0.25 / growth
    fixed = estimate(name, **given)
    np.testing.assert_array_equal(grown.run_probabilities, fixed.run_probabilities)
    assert grown.interval == fixed.interval
    if name == "ams":
        assert grown.rollouts > fixed.rollouts == told["full_rollouts"] + told["branched_rollouts"]
    words = f"{told[size]} {size} in place of {SMALL[name][size]}"
    assert words in {note.kind: note.text for note in grown.notes}["pilot"]


def test_a_hopeless_problem_costs_little_more_than_planned():
    """Put failures beyond reach: the pilot finds none, and the size is raised once."""
    grown, fixed = estimate("ams", 9.0, grow=True), estimate("ams", 9.0)
    twice = estimate("ams", 9.0, particles=40, discard=8)
    assert grown.probability == fixed.probability == 0.0
    np.testing.assert_array_equal(grown.run_probabilities, twice.run_probabilities)
    assert grown.rollouts - twice.rollouts < 0.2 * fixed.rollouts  # the pilot
    assert grown.rollouts < 3.0 * fixed.rollouts
    assert "were not raised further" in {note.kind: note.text for note in grown.notes}["pilot"]
    assert "extinct" in grown.health


def test_many_roots_leave_the_size_as_it_is():
    grown = avrare.estimate(problem(0.3), "ams", seed=3, particles=80, discard=20, grow=True)
    fixed = avrare.estimate(problem(0.3), "ams", seed=3, particles=80, discard=20)
    assert grown.diagnostics["pilot_roots"] >= 20
    np.testing.assert_array_equal(grown.run_probabilities, fixed.run_probabilities)
    assert "pilot" not in {note.kind for note in grown.notes}


@pytest.mark.parametrize("options", [{"runs": 9}, {"budget": "rollouts=2000"}])
def test_no_pilot_where_it_would_cost_more_than_a_tenth(options):
    grown, fixed = estimate("ams", grow=True, **options), estimate("ams", **options)
    assert plain(grown) == plain(fixed)


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("goal", [None, 0.01])
def test_a_budget_bounds_size_and_runs(name, goal):
    options = {"grow": True, "relative_error": goal, "budget": "rollouts=6000"}
    found = estimate(name, **options)
    assert found.rollouts <= 6000
    assert len(found.run_probabilities) >= 10
    assert found.diagnostics.get("goal_reached") is (None if goal is None else False)


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_same_bits_for_workers_and_after_each_kill(tmp_path, name):
    options = {**SMALL[name], "grow": True, "relative_error": 0.02, "runs": 10, "most_runs": 20, "seed": 4}
    whole = avrare.estimate(problem(), name, **options)
    assert len(whole.run_probabilities) == 20
    assert plain(avrare.estimate(problem(), name, workers=2, **options)) == plain(whole)
    result, kills = estimate_through_kills(
        lambda _: avrare.estimate(problem(lives=800), name, checkpoint=tmp_path / "kept", **options)
    )
    assert kills > 1
    assert plain(result) == plain(whole)


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_pilots_leave_the_estimate_unbiased(name):
    task, options = SHORT.problem(), {**SMALL[name], "grow": True}
    values = [avrare.estimate(task, name, seed=seed, **options).probability for seed in range(50)]
    error = np.std(values, ddof=1) / math.sqrt(50)
    assert error < 0.06 * SHORT.probability
    assert abs(np.mean(values) - SHORT.probability) < 4 * error
