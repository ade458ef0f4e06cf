"""Splitting by a learned score: the same failures, unbiased, with the same bits, and only where it gains."""

import json
import tracemalloc

import numpy as np
import pytest
from interruptions import estimate_through_interruptions

import avrare
from avrare.base.errors import UsageError
from avrare.rollout.request import Rollouts
from avrare.testing import faulty_systems
from avrare.testing.problems import walk
from avrare_estimators.ams import learned_score
from avrare_estimators.ams.gain import promise_gain
from avrare_estimators.ams.learned_score import ScoreLearning, committor_scores
from avrare_estimators.ams.splitting import Splitting
from avrare_estimators.common.committor.network import sigmoid
from avrare_estimators.common.committor.potentials import Paths

SMALL = {"particles": 50, "discard": 5, "runs": 4, "pilot": 200, "score": "learned"}

pytestmark = pytest.mark.filterwarnings("ignore::avrare.base.errors.HealthWarning")


def problem(limit=1.2, steps=20, **options):
    return avrare.Problem(faulty_systems.Walk(), avrare.stl(f"always (x < {limit})"), steps, **options)


def estimate(task=None, seed=0, **options):
    return avrare.estimate(task or problem(), "ams", seed=seed, **{**SMALL, **options})


def plain(result):
    content = json.loads(result.to_json())
    del content["seconds"]
    return content, result.failures.noise.tobytes(), result.robustness.tobytes(), result.artifacts


@pytest.fixture
def kept(monkeypatch):
    """Keep whatever was learnt."""
    monkeypatch.setattr(learned_score, "_LEAST_GAIN", -np.inf)


def used(result):
    return result.diagnostics["score"]["used"]


def test_the_same_bits_for_any_chunk(kept):
    one, other = (estimate(problem(chunk=chunk)) for chunk in (64, 4096))
    assert used(one) == "learned"
    assert plain(one) == plain(other)


@pytest.mark.slow
def test_the_same_bits_for_any_workers_and_memory(kept):
    whole = estimate(problem(chunk=50))
    assert plain(estimate(problem(chunk=50), workers=2)) == plain(whole)
    little = estimate(problem(chunk=50), memory=6)  # carries are simulated again, runs come in turn
    assert np.array_equal(little.run_probabilities, whole.run_probabilities)


def test_killed_again_and_again(tmp_path, kept):
    whole = estimate(problem(chunk=100))
    result, interruptions = estimate_through_interruptions(
        lambda: problem(chunk=100),
        lambda tried: estimate(tried, checkpoint=tmp_path / "kept"),
        first=150,
        further=250,
    )
    assert interruptions > 2
    assert used(result) == "learned"
    assert plain(result) == plain(whole)


def test_a_learned_file_saves_the_learning_run(tmp_path, kept):
    first = estimate()
    path = tmp_path / "learned.json"
    path.write_text(json.dumps({"specification": first.artifacts["learned.json"]}))
    again = estimate(learned=str(path), score="problem", pilot=1000)
    assert np.array_equal(again.run_probabilities, first.run_probabilities)
    assert again.diagnostics["learned"] == first.diagnostics["learned"]
    assert first.diagnostics["learning_rollouts"] > 200
    assert again.rollouts == first.rollouts - first.diagnostics["learning_rollouts"]
    assert again.diagnostics["branched_rollouts"] == first.diagnostics["branched_rollouts"]
    short = json.loads(path.read_text())
    del short["specification"]["digest"]
    short["specification"]["potentials"]["levels"][-1] = 0.9
    path.write_text(json.dumps(short))
    with pytest.raises(UsageError, match="no potentials that reach to failure"):
        estimate(learned=str(path))


class Wide(faulty_systems.Walk):
    """A walk with many features."""

    def features(self, state):
        return state["x"][:, None] * np.arange(1.0, 41.0)


class OnlyOfMany(Wide):
    """Many features, which cannot be counted with one rollout."""

    def features(self, state):
        if len(state["x"]) == 1:
            raise ValueError("no features of one alone")
        return super().features(state)


@pytest.mark.parametrize("estimator", ["ams", "smc"])
@pytest.mark.parametrize("system", [Wide, OnlyOfMany])
def test_a_learned_file_of_other_features_is_refused(tmp_path, kept, estimator, system):
    options = SMALL if estimator == "ams" else {"particles": 200}
    learned = avrare.estimate(problem(), estimator, seed=0, **options).artifacts["learned.json"]
    path = tmp_path / "learned.json"
    path.write_text(json.dumps({"specification": learned}))
    other = avrare.Problem(system(), avrare.stl("always (x < 1.2)"), 20)
    with pytest.raises(UsageError, match=r"learned: .* of \d+ features, but the system has 4\d"):
        avrare.estimate(other, estimator, learned=str(path), **({} if estimator == "ams" else options))


@pytest.mark.parametrize("seed", range(3))
def test_features_that_say_nothing_leave_the_score_of_the_problem(seed):
    task = avrare.Problem(faulty_systems.Scrambled(8), avrare.stl("always (x > 0.1)"), 8)
    result = estimate(task, seed, pilot=1000)
    own = estimate(task, seed, score="problem", pilot=1000)
    assert used(result) == "problem"
    assert "the features do not tell failures" in {note.kind: note.text for note in result.notes}["score"]
    assert np.array_equal(result.run_probabilities, own.run_probabilities)
    assert result.interval == own.interval
    assert result.artifacts == own.artifacts == {}
    assert result.rollouts == own.rollouts + result.diagnostics["learning_rollouts"]


def test_failures_out_of_reach_leave_the_score_of_the_problem():
    result = estimate(problem(limit=50.0), floor=1e-3)
    assert used(result) == "problem"
    assert "too few failures" in {note.kind: note.text for note in result.notes}["score"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"score": "best"}, "score"),
        ({"pilot": 100}, "pilot"),
        ({"score": "problem", "pilot": 300}, "pilot belongs to"),
        ({"look_ahead": 2}, "look_ahead does not go with a learned score"),
        ({"early_stop": True}, "early_stop does not go with a learned score"),
        ({"variant": "published"}, "published"),
        ({"learned": "nowhere.json"}, "no such file"),
        ({"budget": "seconds=3"}, "cannot be stopped by the clock"),
        ({"budget": "steps=20000"}, "does not pay for learning a score"),
        ({"budget": "rollouts=12000", "particles": 1100}, "and for a run of 1100"),
        ({"memory": 0.1}, "more than the option memory"),
    ],
)
def test_bad_options_are_refused(options, words):
    with pytest.raises(UsageError, match=words):
        estimate(**options)


@pytest.mark.parametrize(("kind", "amount"), [("steps", 200_000), ("rollouts", 20_000)])
def test_a_budget_is_kept_and_used(kept, kind, amount):
    result = estimate(budget=f"{kind}={amount}")
    spent = result.simulated_steps if kind == "steps" else result.rollouts
    assert 0.3 * amount < spent <= amount
    assert used(result) == "learned"


def test_the_factor_by_which_a_budget_is_to_be_raised_suffices():
    options = {"particles": 1100, "discard": 100, "runs": 1}
    with pytest.raises(UsageError) as refused:
        estimate(budget="rollouts=12000", **options)
    factor = float(refused.value.hint.split()[2])
    assert 1.0 < factor < 1.2
    amount = 12_000 * factor
    assert estimate(budget=f"rollouts={amount:g}", **options).rollouts < amount


@pytest.mark.slow
def test_the_memory_asked_for_suffices(kept, monkeypatch):
    """Hold the features of all rollouts, and what reads them, in the memory that was announced."""
    announced, demand = [], Splitting.demand

    def watched(self, plan, carry):
        announced.append(demand(self, plan, carry))
        return announced[-1]

    monkeypatch.setattr(Splitting, "demand", watched)
    monkeypatch.setattr(learned_score, "_TRAINING", 300)
    task = avrare.Problem(Wide(), avrare.stl("always (x < 1.9)"), 50)
    tracemalloc.start()
    assert used(estimate(task, particles=100, discard=10, pilot=600)) == "learned"
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < announced[0].bytes


def test_the_forecast_adds_what_learning_has_cost():
    def followed(score, **options):
        seen = []
        result = estimate(runs=11, grow=True, score=score, progress=seen.append, **options)
        return result, [info for info in seen if info.forecast]

    own, without = followed("problem", pilot=1000)
    result, seen = followed("learned")
    assert used(result) == "problem"
    learnt = result.simulated_steps - own.simulated_steps
    assert learnt > 0
    assert len(seen) > len(without) > 100
    # All but what is told before the first rollouts, from the end on: learning tells something, too.
    for one, other in zip(seen[:1:-1], without[:0:-1], strict=True):
        assert one.forecast.least == pytest.approx(other.forecast.least + learnt)
        assert one.forecast.most == pytest.approx(other.forecast.most + learnt)


def test_without_steps_nothing_is_learnt():
    task = avrare.Problem(faulty_systems.Walk(), avrare.stl("always (x < 1.2)"), 0)
    assert "score" not in estimate(task).diagnostics


def test_all_rollouts_of_the_learning_run_teach_with_the_weights_that_they_had(monkeypatch):
    taught, ended = [], ScoreLearning.ended

    def recorded(self, plan, weight, population, spent):
        found = self.table.finish(weight, population)
        self.table._retired.pop()
        taught.append((found, weight * population.violated.mean(), spent.rollouts))
        return ended(self, plan, weight, population, spent)

    monkeypatch.setattr(ScoreLearning, "ended", recorded)
    estimate()
    ((paths, probability, rollouts),) = taught
    assert len(paths.weights) == rollouts
    assert paths.weights.mean() == pytest.approx(1.0)
    assert (paths.weights * paths.violated).mean() == pytest.approx(probability)
    # A child has the past of its parent: its running score never falls.
    assert (np.diff(paths.features[:, :, -1], axis=1) >= 0.0).all()
    assert (paths.features[:, -1, -1] <= paths.score + 1e-6).all()


class Odds:
    """Log odds that are a feature."""

    def __init__(self, schedule, column):
        self.schedule, self.column = np.array(schedule), column

    def log_odds(self, step, features):
        return features[:, self.column]


def test_scores_rise_to_the_largest_odds_and_to_infinity_at_a_failure():
    odds = np.array([[1.0, 3.0, 2.0], [9.0, -2.0, -1.0], [0.0, 5.0, np.nan]])[..., None]
    rollouts = Rollouts(
        np.zeros((3, 1)),
        np.array([[False], [True], [False]]),
        np.zeros(3, bool),
        np.zeros((3, 7)),
        0,
        features=odds,
    )
    start, before = np.array([-1, 2, 2]), np.array([-np.inf, 0.5, 0.5])
    scores = committor_scores(Odds([1, 3, 5], 0), rollouts, start, before)
    assert scores[0].tolist() == [-np.inf, 1.0, 1.0, 3.0, 3.0, 3.0, 3.0]
    assert scores[1, 3:].tolist() == [0.5, 0.5, 0.5, np.inf]  # what is before its start is its parent's
    assert scores[2, 3:].tolist() == [5.0] * 4


@pytest.mark.parametrize("column", [0, 1])
def test_the_gain_is_that_of_what_tells_failures_apart(column):
    """Promise a gain of the true odds over a score that says nothing, and none of odds that say nothing."""
    rng = np.random.default_rng(0)
    n = 20_000
    odds, noise, score = rng.normal(-4.0, 2.0, n), rng.normal(-4.0, 2.0, n), rng.normal(0.0, 1.0, n)
    failed = rng.random(n) < sigmoid(odds)
    features = np.repeat(np.stack([odds, noise, score], axis=1)[:, None], 2, axis=1)
    paths = Paths(features, score, failed, np.ones(n), np.arange(n))
    promise = promise_gain(Odds([1, 5], column), paths, 10)
    assert 0.01 < promise.error < 0.2
    if column == 0:
        assert promise.gain - 3.0 * promise.error > 1.3
    else:
        assert promise.gain - promise.error < 1.2


@pytest.mark.slow
def test_unbiased_over_seeds(kept, monkeypatch):
    """Use whatever was learnt, from little training: a bad score costs but does not lie."""
    exact = walk(2.8, 50)
    monkeypatch.setattr(learned_score, "_TRAINING", 600)
    options = {"particles": 100, "discard": 10, "runs": 10, "pilot": 300}
    results = [estimate(exact.problem(), seed, **options) for seed in range(8)]
    assert [used(result) for result in results].count("learned") > 5
    values = np.array([result.run_probabilities.mean() for result in results]) / exact.probability
    error = values.std(ddof=1) / np.sqrt(len(values))
    assert error < 0.08
    assert abs(values.mean() - 1.0) < 4.0 * error
    covers = [one.interval[0] <= exact.probability <= one.interval[1] for one in results]
    assert np.mean(covers) > 0.95 - 4.0 * np.sqrt(0.05 * 0.95 / len(covers))
