"""The search for a failure, and for the most likely one."""

import numpy as np
import pytest

import avrare
from avrare.analysis.failures.falsify import falsify, find_failures
from avrare.analysis.failures.tape_evaluator import TapeEvaluator
from avrare.testing.walk_problems import walk


@pytest.fixture(scope="module")
def rare():
    """Return a walk of 20 steps that fails beyond 5 sigma: p = 4e-7, smallest norm exactly 5."""
    return walk(5.0 * 0.1 * np.sqrt(20.0), steps=20).problem()


def test_a_rare_failure_is_found_and_then_the_nearest(rare):
    found = falsify(rare, seed=0, budget=2500)
    assert rare.replay(found.noise[None]).violated.all()
    assert 5.0 <= found.norm < 5.1
    assert found.norm == np.linalg.norm(found.noise) <= found.first_norm
    assert found.first_rollouts < found.rollouts <= 2500
    steps = found.noise[1:, 0]
    assert np.corrcoef(np.cumsum(steps), np.arange(20))[0, 1] > 0.99  # a steady push is the likeliest way


def test_the_seed_decides(rare):
    first, again, other = (falsify(rare, seed=seed, budget=800) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.noise, again.noise, strict=True)
    assert (first.norm, first.first_norm, first.rollouts) == (again.norm, again.first_norm, again.rollouts)
    assert other.norm != first.norm


def test_a_problem_that_cannot_fail_finds_nothing(weighted):
    found = falsify(weighted(np.zeros((3, 3))), budget=300)
    assert (found.noise, found.rollouts) == (None, 300)


def test_a_failure_without_noise_needs_no_search(weighted):
    found = falsify(weighted(np.zeros((3, 3)), "eventually (x > 1)"))
    assert (found.norm, found.rollouts) == (0.0, 1)
    assert not found.noise.any()


def test_errors_are_counted_and_not_taken_for_failures(weighted):
    weights = np.ones((6, 3)) / 4
    problem = weighted(weights, raises=1.5)
    found = falsify(problem, budget=1500)
    assert found.errors > 0
    outcome = problem.replay(found.noise[None])
    assert outcome.violated.all()
    assert (found.noise[:, 0] <= 1.5).all()


def test_all_rollouts_break_down(weighted):
    found = falsify(weighted(np.ones((6, 3)), nan=-9.0), budget=200)
    assert (found.noise, found.errors) == (None, 200)


def test_failures_of_a_climb_come_in_order(linear):
    problem = linear.problem("near")
    found = find_failures(TapeEvaluator(problem, 2000), seed=1)
    norms = [float(np.linalg.norm(tape)) for tape in found]
    assert norms == sorted(norms)
    assert problem.replay(np.stack(found)).violated.all()


def test_a_formula_that_may_still_come_true():
    class Stay:
        noise_size = 1

        def initial(self, noise):
            return {"x": np.zeros(len(noise))}

        def step(self, state, noise):
            return {"x": state["x"] + 0.3 + 0.1 * noise[:, 0]}

        def signals(self, state):
            return state

    problem = avrare.Problem(Stay(), avrare.stl("eventually (x > 2)"), steps=10)
    found = falsify(problem, budget=1500)
    assert problem.replay(found.noise[None]).violated.all()
    assert found.norm == pytest.approx(10.0 / np.sqrt(10.0), rel=0.03)


def test_a_search_cut_short_from_any_start_is_not_finished(rare, monkeypatch):
    ends = iter([0, 10])  # rollouts that are left after the search from each start

    def spent(trials, tape, seed):
        trials.rollouts = trials.budget - next(ends)
        return tape

    monkeypatch.setattr("avrare.analysis.failures.falsify.find_design_point", spent)
    found = falsify(rare, seed=1, budget=4000)
    assert found.noise is not None
    assert not found.finished
