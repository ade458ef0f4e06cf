"""Sequential Monte Carlo with learned potentials: unbiased, covering, with the same bits, and honest."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import avrare
from avrare.base.errors import UsageError
from avrare.estimation.result import intervals
from avrare.testing import faulty_systems
from avrare_estimators.common.learning.dictionary import dictionary_bytes
from avrare_estimators.smc import network as network_module
from avrare_estimators.smc.estimator import SequentialMonteCarlo
from avrare_estimators.smc.network import Examples, fit
from avrare_estimators.smc.particles import Particles
from avrare_estimators.smc.potentials import Paths, Potentials, learn
from avrare_estimators.smc.summary import Counted
from estimates import estimate_through_kills, plain

SMALL = {"particles": 100, "runs": 5, "pilot": 400, "stages": 5, "times": 6}


def problem(limit=1.6, lives=np.inf, **options):
    system = faulty_systems.Mortal(faulty_systems.Walk(), lives)
    return avrare.Problem(system, avrare.stl(f"always (x < {limit})"), 20, **options)


def scrambled(probability):
    return avrare.Problem(faulty_systems.Scrambled(8), avrare.stl(f"always (x > {probability})"), 8)


def estimate(task=None, seed=0, **options):
    return avrare.estimate(task or problem(), "smc", seed=seed, **{**SMALL, **options})


@pytest.fixture
def batches(monkeypatch):
    """Return numbers of runs that advanced together."""
    found, begin = [], Particles.begin

    def recorded(course, first_run, runs):
        found.append(runs)
        return begin(course, first_run, runs)

    monkeypatch.setattr(Particles, "begin", recorded)
    return found


@pytest.mark.parametrize("proposal", ["learned", "none"])
def test_the_same_bits_for_any_chunk(proposal):
    one, other = (plain(estimate(problem(chunk=chunk), proposal=proposal)) for chunk in (64, 4096))
    assert one == other


@pytest.mark.slow
def test_the_same_bits_for_any_workers_and_memory(batches):
    whole = plain(estimate(problem(chunk=50)))
    assert plain(estimate(problem(chunk=50), workers=2)) == whole
    least = dictionary_bytes(20) / 2**20 + 2
    assert plain(estimate(problem(chunk=50), memory=least)) == whole
    many = {"proposal": "none", "particles": 400}
    in_batches = estimate(problem(chunk=50), memory=1.5, **many)
    assert 1 < sum(np.cumsum(batches[::-1]) <= 5) < 5
    assert plain(in_batches) == plain(estimate(problem(chunk=50), **many))


@pytest.mark.slow
@pytest.mark.parametrize("proposal", ["learned", "none"])
def test_killed_again_and_again(tmp_path, proposal):
    whole = plain(estimate(problem(chunk=100), proposal=proposal))
    options = {"proposal": proposal, "checkpoint": tmp_path / "kept"}
    result, kills = estimate_through_kills(
        lambda kills: estimate(problem(chunk=100, lives=100 + 40 * kills), **options)
    )
    assert kills > 2
    assert plain(result) == whole


class Heavy(faulty_systems.Walk):
    """Walk whose state has 20 kB."""

    def initial(self, noise):
        return {**super().initial(noise), "ballast": np.zeros((len(noise), 2500))}

    def step(self, state, noise):
        return {**super().step(state, noise), "ballast": state["ballast"]}


def test_runs_that_do_not_fit_in_memory_together_advance_in_turn(batches):
    task = avrare.Problem(Heavy(), avrare.stl("always (x < 0.5)"), 4)
    estimate(task, proposal="none", stages=1, memory=13)
    assert batches[-5:] == [1] * 5


def test_the_kind_of_interval_does_not_rest_on_the_first_batch(monkeypatch):
    expected = estimate(problem(limit=1.2), proposal="none")
    count = Counted.of

    def first_is_plain(particles):
        return replace(count(particles), plain=particles.first_run == 0)

    monkeypatch.setattr(Counted, "of", first_is_plain)
    monkeypatch.setattr(SequentialMonteCarlo, "_together", lambda *_: 1)
    found = estimate(problem(limit=1.2), proposal="none")
    assert "learning" not in {note.kind for note in found.notes}
    assert found.interval == expected.interval
    assert found.health == expected.health
    assert found.blind_bound == expected.blind_bound


def test_rows_stored_from_other_parents_are_refused(tmp_path, monkeypatch):
    """Refuse: learning again may differ in its last digits, and so may the parents that it chooses."""
    weigh, folder = Potentials.__call__, tmp_path / "kept"

    def call(progress):
        return estimate(proposal="none", runs=2, checkpoint=folder, progress=progress)

    def kill(info):
        if list(folder.rglob("000003-*.npz")):  # of a segment whose rows continue others
            raise KeyboardInterrupt

    def otherwise(self, step, features):
        return 1.0 / weigh(self, step, features)

    with pytest.raises(KeyboardInterrupt):
        call(kill)
    monkeypatch.setattr(Potentials, "__call__", otherwise)
    with pytest.raises(UsageError, match="belongs to another estimate"):
        call(False)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"particles": 3}, "particles"),
        ({"proposal": "guess"}, "proposal"),
        ({"defensive": 0.1}, "defensive"),
        ({"times": 0}, "times"),
        ({"relative_error": 0.1, "runs": 2}, "relative_error needs 5"),
        ({"grow": True}, "grow"),
        ({"budget": "seconds=3"}, "cannot be stopped by the clock"),
        ({"budget": "steps=900"}, "does not pay for 5 runs of 20 particles"),
        ({"memory": 0.1}, "more than the option memory"),
    ],
)
def test_bad_options_are_refused(options, words):
    with pytest.raises(UsageError, match=words):
        estimate(**options)


@pytest.mark.parametrize(("kind", "amount"), [("steps", 30_000), ("rollouts", 3000)])
def test_a_budget_is_kept_and_used(kind, amount):
    result = estimate(problem(), budget=f"{kind}={amount}")
    spent = result.simulated_steps if kind == "steps" else result.rollouts
    assert 0.3 * amount < spent <= amount


def test_all_starts_and_copies_are_rollouts(monkeypatch):
    """Count those of the particles that only teach too."""
    counts = {"starts": 0, "copies": 0, "taught": 0}
    begin, resample = Particles.begin, Particles._resample

    def begun(course, first_run, runs):
        counts["starts"] += runs * course.particles
        counts["taught"] += course.learning * runs * course.particles
        return begin(course, first_run, runs)

    def resampled(self, features, place):
        new = resample(self, features, place)
        counts["copies"] += new.copies - self.copies
        counts["taught"] += self.course.learning * (new.copies - self.copies)
        return new

    monkeypatch.setattr(Particles, "begin", begun)
    monkeypatch.setattr(Particles, "_resample", resampled)
    result = estimate(problem(limit=2.5), proposal="none", particles=40)
    assert result.diagnostics["pilot_rollouts"] == SMALL["pilot"] + counts["taught"] > SMALL["pilot"]
    assert result.rollouts == SMALL["pilot"] + counts["starts"] + counts["copies"]


class BreaksAfterFailure(faulty_systems.Walk):
    """Walk that breaks down in the step after x has exceeded 1."""

    def move(self, x, noise):
        return np.where(x > 1.0, np.nan, super().move(x, noise))

    def signals(self, state):
        return {"x": state["x"], "half": 0.5 * state["x"]}


def test_a_failure_that_breaks_down_later_counts_for_any_score():
    formula = avrare.stl("always (x < 1) and always (half < 40)")
    for score in (None, "robustness"):
        task = avrare.Problem(BreaksAfterFailure(), formula, 20, score=score)
        result = estimate(task, particles=300, runs=2, proposal="none")
        assert 0.008 < result.probability < 0.04  # exact: 0.0188, without these failures 0.003
        # Where the complete rollout has no robustness, a failure keeps that of its end.
        assert np.isnan(task.robustness(result.failures.noise)).any()
        assert (result.failures.robustness <= 0.0).all()
        assert not np.isnan(result.worst.robustness)


def test_without_structure_it_is_monte_carlo():
    """Leave the pilot's failures out: the interval is that of the later rollouts alone."""
    for seed in range(3):
        result = estimate(scrambled(0.02), seed, runs=2)
        assert "Monte Carlo" in {note.kind: note.text for note in result.notes}["learning"]
        assert result.interval[0] <= result.probability <= result.interval[1]
        exact = intervals.clopper_pearson(round(200 * result.probability), 200, 0.95)
        assert result.interval == exact


def test_the_network_learns_a_known_committor():
    """Learn, from x at one of two steps, the chance that x plus fresh noise exceeds a bound."""
    rng = np.random.default_rng(3)
    x = rng.standard_normal((6000, 2)).cumsum(axis=1)
    end = x[:, 1] + rng.standard_normal(6000)
    features = np.stack([x, x], axis=2)
    examples = Examples(features, end[:, None] > 2.5, np.ones(6000), np.arange(6000) % 5 == 0)
    network = fit(examples, (1,))
    at = np.array([[-1.0, -1.0], [1.0, 1.0], [2.5, 2.5]])
    found = network.probabilities(1, at)[:, 0]
    assert abs(found[2] - 0.5) < 0.12
    assert abs(found[1] - 0.067) < 0.04
    assert found[0] < 0.01
    assert abs(network.probabilities(0, at)[1, 0] - 0.144) < 0.05
    again = fit(examples, (1,))
    assert all(map(np.array_equal, network.layers, again.layers))
    # A row's bits do not depend on its company.
    assert np.array_equal(network.probabilities(1, at)[1:2], network.probabilities(1, at[1:2]))


def test_rows_are_evaluated_in_blocks(monkeypatch):
    """Give the bits of a single block, in memory that does not grow with the rows but for the answer."""
    rng = np.random.default_rng(5)
    features = rng.standard_normal((2 * network_module._BLOCK, 2, 2))
    examples = Examples(features, features[:, 1, :1] > 1.0, np.ones(len(features)), features[:, 0, 0] > 1.0)
    monkeypatch.setattr(network_module, "_MOST_STEPS", 300)
    network, rows = fit(examples, (1,)), features.reshape(-1, 2)
    tracemalloc.start()
    found = network.probabilities(1, rows)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < found.nbytes + 1500 * network_module._BLOCK
    monkeypatch.setattr(network_module, "_BLOCK", len(rows))
    assert np.array_equal(found, network.probabilities(1, rows))


def test_features_that_tell_nothing_give_no_gain():
    rng = np.random.default_rng(4)
    features = rng.standard_normal((3000, 3, 2))
    violated = rng.random(3000) < 0.05
    score = np.where(violated, 1.0, rng.random(3000))
    paths = Paths(features, score, violated, np.ones(3000), np.arange(3000))
    # The last feature is the score so far, below all levels.
    paths.features[:, :, -1] = -9.0
    found = learn([paths], (2,))
    assert found is not None
    assert found.useful == []
