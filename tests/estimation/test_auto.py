"""``auto``: a pilot chooses the estimator; what counts is as unbiased as without the choice."""

from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np
import pytest

import avrare
from avrare.estimation.choice import auto
from avrare.estimation.choice.auto import Auto
from avrare.estimation.choice.auto_config import AutoConfig
from avrare.estimation.choice.auto_rules import Aim, forecast_gain
from avrare.estimation.loop.checkpoint import SaveError
from avrare.estimation.loop.loop import run
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import GaveUp, Settings
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.intervals import log_normal
from avrare.rollout.executors.serial import SerialExecutor
from avrare.testing.faulty_systems import Counting, Killed, Mortal, Scrambled, Walk
from avrare.testing.repeated_estimates import coverage_at_most, deviation
from avrare.testing.static_problems import four_branch
from avrare.testing.walk_problems import walk
from estimates import estimate_through_kills, plain

pytestmark = pytest.mark.filterwarnings("ignore::avrare.base.errors.HealthWarning")
HOPELESS = "always (x > 2e-3)"
FREQUENT, RARE = "always (x < 2.5)", "always (x < 8)"
STEPS = 20


def plains(results):
    return [plain(one) for one in results.values()]


def problem(*limits, system=None, chunk=None, steps=STEPS):
    specifications = {f"below_{k}": avrare.stl(text) for k, text in enumerate(limits)}
    return avrare.Problem(system or Walk(scale=0.5), specifications, steps=steps, chunk=chunk)


def stuck(system=None):
    return problem(HOPELESS, system=system or Scrambled(5), steps=5)


def chosen(result):
    return result.diagnostics["choice"]


def test_each_specification_gets_its_own():
    both = problem(FREQUENT, RARE)
    results = avrare.estimate_all(both, "auto", seed=1, rollouts=5000)
    frequent, rare = results["below_0"], results["below_1"]
    assert list(results) == ["below_0", "below_1"]
    assert (frequent.estimator, rare.estimator) == ("mc", "is")
    assert "rollouts of the pilot" in chosen(frequent)["reason"]
    assert [one["estimator"] for one in chosen(rare)["tried"]] == ["mc"]
    low, high = rare.interval
    assert low < walk(8.0, STEPS, 0.5).probability < high


def test_monte_carlo_has_the_bits_of_mc():
    result = avrare.estimate(problem("always (x < 1)"), "auto", seed=3, relative_error=0.3)
    same = avrare.estimate(problem("always (x < 1)"), "mc", seed=3, relative_error=0.3)
    assert (result.estimator, result.probability, result.interval) == ("mc", same.probability, same.interval)
    pilot = chosen(result)["tried"][0]["rollouts"]
    assert result.rollouts == same.rollouts + pilot


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"rollouts": 500}, "too few rollouts"),
        ({"budget": "steps=9000"}, "too few rollouts"),
        ({"threshold": 0.3, "rollouts": 2000}, "threshold"),
    ],
)
def test_without_a_pilot_it_is_mc(options, reason):
    result = avrare.estimate(problem(FREQUENT), "auto", seed=3, **options)
    assert result.estimator == "mc"
    assert reason in chosen(result)["reason"]
    assert chosen(result)["tried"] == []
    same = avrare.estimate(problem(FREQUENT), "mc", seed=3, **options)
    assert (result.probability, result.rollouts) == (same.probability, same.rollouts)


def test_a_budget_of_seconds_is_for_monte_carlo():
    settings, calls = Settings(budget=Budget("seconds", 60.0)), []

    def execute(problem, estimator, settings, name):
        calls.append((type(estimator), settings.budget.kind))
        return [avrare.estimate(problem, "mc", rollouts=10)]

    (result,) = Auto(AutoConfig()).estimate_by(problem(FREQUENT), settings, execute)
    assert calls == [(MonteCarlo, "seconds")]
    assert "clock" in chosen(result)["reason"]


def test_cost_is_honest_and_budget_kept():
    counting = Counting(Walk(scale=0.5))
    result = avrare.estimate(problem(RARE, system=counting), "auto", seed=1, budget=f"steps={5000 * STEPS}")
    assert result.estimator == "is"
    assert result.simulated_steps <= 5000 * STEPS
    assert result.simulated_steps <= counting.rows <= 1.06 * result.simulated_steps  # probes and a replay
    tried = sum(one["rollouts"] for one in chosen(result)["tried"])
    assert result.rollouts == chosen(result)["counting_rollouts"] + tried


def test_a_budget_of_rollouts_counts_branches():
    result = avrare.estimate(stuck(), "auto", seed=2, budget="rollouts=6000")
    assert len(chosen(result)["tried"]) > 2
    assert 5900 <= result.rollouts <= 6000


def test_falls_back_where_nothing_pays():
    result = avrare.estimate(stuck(), "auto", seed=2, rollouts=6000)
    assert result.estimator == "mc"
    assert chosen(result)["tried"][0]["estimator"] == "mc"
    assert {"is", "ams"} <= {one["estimator"] for one in chosen(result)["tried"]}
    assert "tried in vain: is" in chosen(result)["reason"]
    assert result.interval[0] <= 2e-3 <= result.interval[1]


def test_a_plateau_is_left_to_monte_carlo():
    impossible = problem("always (min(x, 3) < 3.5)")
    result = avrare.estimate(impossible, "auto", seed=2, rollouts=6000)
    assert (result.estimator, result.probability) == ("mc", 0.0)
    assert "learning" in chosen(result)["tried"][1]["reason"]
    assert chosen(result)["tried"][1]["rollouts"] < 2000


@pytest.mark.parametrize("limits", [(FREQUENT, RARE), (FREQUENT,)])
def test_chunks_and_order_change_no_bit(limits):
    cut = (problem(*limits, chunk=size) for size in (4096, 333))
    large, small = (avrare.estimate_all(one, "auto", seed=4, rollouts=5000) for one in cut)
    assert plains(large) == plains(small)


@pytest.mark.slow
def test_killed_it_goes_on(tmp_path):
    both = problem(FREQUENT, RARE, chunk=250)
    whole = avrare.estimate_all(both, "auto", seed=4, rollouts=5000)

    def attempt(kills):
        mortal = problem(FREQUENT, RARE, chunk=250, system=Mortal(Walk(scale=0.5), 500))
        return avrare.estimate_all(mortal, "auto", seed=4, rollouts=5000, checkpoint=tmp_path / "kept")

    results, deaths = estimate_through_kills(attempt)
    assert deaths > 1
    assert plains(results) == plains(whole)
    assert not (tmp_path / "kept").exists()


def test_cross_check_is_of_another_family():
    result = avrare.estimate(problem(RARE), "auto", seed=1, rollouts=5000, cross_check=True)
    assert (result.estimator, result.cross_check.estimator) == ("is", "ess")


def test_rules():
    goal, spend = Aim(0.2, 50_000), Aim(None, 30_000)
    assert (goal.failures, goal.pilot, spend.pilot) == (5, 3000, 2000)
    assert goal.is_frequent(FreshRows(3000, 2))
    assert not goal.is_frequent(FreshRows(3000, 1))
    assert spend.is_frequent(FreshRows(2000, 6))
    assert not spend.is_frequent(FreshRows(2000, 5))
    assert goal.may_try(12_000, FreshRows(3000, 1))
    assert not goal.may_try(13_000, FreshRows(3000, 1))
    # learning in vain costs at most 0.3 of what Monte Carlo then needs
    assert 3 * goal.pilot / goal.estimate_need(FreshRows(3000, 1)) < 0.3
    assert forecast_gain(FreshRows(3000, 0), 0.0, float("nan"), 100.0) == 0.0
    assert forecast_gain(FreshRows(1000, 0), 1e-4, 0.5, 1000.0) == pytest.approx(20.0, rel=1e-3)
    assert forecast_gain(FreshRows(1000, 10), 1e-4, 0.5, 1000.0) < 1.0  # the pilot saw more


def test_more_rollouts_find_what_fewer_do():
    task, before = problem(RARE), 0.0
    for rollouts in range(5000, 60_000, 500):
        aim = Aim(None, rollouts)
        pilot = auto._Attempt("mc", "pilot", aim.pilot, aim.pilot * STEPS)
        work = auto._Work(task, Settings(seed=1), None, aim, AutoConfig())
        first = work._first_budget(task, "is", [pilot]).amount / STEPS
        assert before <= first <= rollouts - aim.pilot
        # after learning in vain, half of it, another estimator may be tried
        assert aim.may_try(aim.pilot + first / 2.0 + aim.pilot, FreshRows(aim.pilot, 0))
        before = first


@pytest.mark.slow
@pytest.mark.parametrize("reference", [walk(0.74, 10), four_branch(4.9)], ids=["steps", "static"])
def test_unbiased_where_the_choice_is_a_toss(reference):
    """Leave out pilot failures, which decide between two estimators."""
    runs = [avrare.estimate(reference.problem(), "auto", seed=s, rollouts=5000) for s in range(20)]
    share = np.mean([one.estimator == "mc" for one in runs])
    assert 0.1 < share < 0.9
    values = np.array([one.probability for one in runs])
    assert abs(deviation(values, reference.probability)) < 3.5
    hits = sum(one.interval[0] <= reference.probability <= one.interval[1] for one in runs)
    assert coverage_at_most(hits, len(runs), 0.95) > 1e-3


def test_the_pilot_forecasts_the_failures_at_which_it_stops():
    seen = []
    avrare.estimate(problem("always (x < 1)"), "auto", seed=3, relative_error=0.3, progress=seen.append)
    assert seen[0].forecast.least == Aim(0.3, 1e6).failures
    assert seen[1].forecast.given.endswith(f" of {Aim(0.3, 1e6).failures} failures")


@pytest.mark.parametrize("part", ["is", "try-ams", "ams"])
def test_a_part_that_breaks_is_told(part, monkeypatch):
    """Pass the error on: a full disk or a damaged file is no reason to take another estimator."""
    monkeypatch.setattr("avrare.estimation.choice.auto.pays", lambda gain: True)

    def execute(problem, estimator, settings, name):
        if name.endswith(f"+{part}"):
            raise SaveError("no space is left")
        return run(problem, estimator, SerialExecutor(), settings)

    with pytest.raises(SaveError, match="no space"):
        Auto(AutoConfig(rollouts=6000)).estimate_by(stuck(), Settings(seed=2), execute)


def test_a_damaged_chunk_of_a_part_is_told(tmp_path):
    folder = tmp_path / "kept"

    def call(progress):
        task = problem(RARE, chunk=500)
        return avrare.estimate(task, "auto", seed=1, rollouts=5000, checkpoint=folder, progress=progress)

    def kill(info):
        if stored():
            raise Killed

    def stored():
        return [path for path in folder.rglob("*.npz") if path.parent.name.endswith("+is")]

    with pytest.raises(Killed):
        call(kill)
    stored()[0].write_bytes(b"no more")
    with pytest.raises(avrare.UsageError, match="damaged"):
        call(False)


def test_a_part_that_cannot_begin_is_passed_over():
    class Closed(Scrambled):
        lacks = MappingProxyType({"branches": "its states are out of reach"})

    result = avrare.estimate(stuck(Closed(5)), "auto", seed=2, rollouts=6000)
    tried = {one["estimator"]: one["reason"] for one in chosen(result)["tried"]}
    assert result.estimator == "mc"
    assert "out of reach" in tried["ams"]


def test_the_time_of_a_part_that_gave_up_counts():
    plateau, seconds = problem("always (min(x, 3) < 3.5)"), []

    def execute(problem, estimator, settings, name):
        try:
            results = run(problem, estimator, SerialExecutor(), settings)
        except GaveUp as end:
            seconds.append(end.seconds)
            raise
        seconds.append(results[0].seconds)
        return results

    (result,) = Auto(AutoConfig(rollouts=6000)).estimate_by(plateau, Settings(seed=2), execute)
    assert [one["estimator"] for one in chosen(result)["tried"]][:2] == ["mc", "is"]
    assert min(seconds) > 0.0
    assert result.seconds == pytest.approx(sum(seconds))


def test_the_pilot_counts_in_the_bound_and_contradicts(monkeypatch):
    alone = avrare.estimate(problem(RARE), "auto", seed=1, rollouts=5000)
    assert alone.estimator == "is"
    with monkeypatch.context() as patch:
        patch.setattr(auto, "FreshRows", lambda rows, failures, errors: FreshRows(100 * rows, 3, errors))
        more = avrare.estimate(problem(RARE), "auto", seed=1, rollouts=5000)
    assert more.probability == alone.probability
    assert more.blind_bound < 0.1 * alone.blind_bound
    with monkeypatch.context() as patch:
        patch.setattr(auto, "FreshRows", lambda rows, failures, errors: FreshRows(rows, 30, errors))
        patch.setattr(Aim, "is_frequent", lambda aim, evidence: False)
        hidden = avrare.estimate(problem(RARE), "auto", seed=1, rollouts=5000)
    assert "contradicted" in hidden.health
    low, high = hidden.fresh.interval(0.95)
    assert hidden.interval[0] <= high <= hidden.interval[1]
    assert low > alone.interval[1]


def test_monte_carlo_as_a_second_witness_draws_tapes_of_its_own(monkeypatch):
    seeds = []
    draw = lambda self, *_: seeds.append(self.settings.seed) or [None]  # noqa: E731
    monkeypatch.setattr(auto._Work, "_monte_carlo", draw)
    frequent = replace(avrare.estimate(problem(RARE), "ess", seed=1), probability=1.0)
    work = auto._Work(problem(RARE), Settings(seed=1), None, Aim(0.2, 50_000.0), AutoConfig())
    work._second_witness(frequent, problem(RARE), [])
    assert seeds != [1]


def test_witnesses_that_disagree_send_the_budget_to_the_one_that_finds_more(monkeypatch):
    rarer = problem("always (x < 12)")
    low = replace(avrare.estimate(rarer, "ess", seed=1), rollouts=5000, simulated_steps=5000 * STEPS)
    high = replace(low, probability=50 * low.probability, estimator="ams")
    high = replace(high, interval_at=partial(log_normal, high.probability, 0.01, freedom=9))
    monkeypatch.setattr(auto._Work, "_first_witness", lambda *_: low)
    monkeypatch.setattr(auto._Work, "_second_witness", lambda *_: high)
    monkeypatch.setattr(auto, "in_doubt", lambda result: True)
    repeated = []
    repeat = lambda self, witness, *_: repeated.append(witness.estimator) or high  # noqa: E731
    monkeypatch.setattr(auto._Work, "_repeat", repeat)
    result = avrare.estimate(rarer, "auto", seed=1, rollouts=40_000)
    assert repeated == ["ams"]
    assert result.probability == pytest.approx(high.probability)
    assert "contradicted" not in result.health
    assert [one["estimator"] for one in chosen(result)["tried"]][-1] == "ess"
