"""Shrinking finds what a failure needs, and nothing else."""

import re

import numpy as np
import pytest

import avrare
from avrare.analysis.failures.shrink import shrink
from avrare.base.errors import UsageError


def random(shape, seed=0):
    return np.random.default_rng(seed).standard_normal(shape)


def test_a_failure_of_one_number(weighted):
    weights = np.zeros((40, 3))
    weights[17, 1] = 1.0
    tape = random((40, 3))
    tape[17, 1] = 4.0
    found = shrink(weighted(weights), tape)
    assert np.argwhere(found.noise).tolist() == [[17, 1]]
    assert found.noise[17, 1] == pytest.approx(3.0, abs=0.01)
    assert found.noise[17, 1] >= 3.0
    assert (found.nonzero, found.after) == (1, found.noise[17, 1])
    assert found.ratio == found.after / found.before == found.after / np.linalg.norm(tape)


@pytest.mark.slow
def test_a_tenth_of_the_norm_or_the_reason(weighted):
    weights = np.zeros((400, 3))
    weights[17, 1] = 3.0
    tape = random((400, 3))
    tape[17, 1] = 4.0
    found = shrink(weighted(weights), tape)
    assert found.ratio < 0.05
    assert found.reason is None
    short = random((40, 3))
    short[17, 1] = 4.0
    found = shrink(weighted(weights[:40] / 3.0), short)
    assert found.ratio > 0.1
    assert re.fullmatch(
        rf"a tenth is a norm of {0.1 * found.before:.2g}; none of \d{{3,}} tapes with a norm below 3 fails",
        found.reason,
    )


def test_two_numbers_that_must_come_together(weighted):
    weights = np.zeros((30, 3))
    weights[5, 0] = weights[20, 2] = 1.0
    tape = random((30, 3), 1)
    tape[5, 0] = tape[20, 2] = 2.0
    found = shrink(weighted(weights), tape)
    assert np.argwhere(found.noise).tolist() == [[5, 0], [20, 2]]
    assert found.after <= np.linalg.norm([2.0, 2.0])


def test_the_result_fails_and_no_smaller_tape_does(weighted):
    problem = weighted(random((25, 3), 2) / 5)
    tape = random((25, 3), 3) + 0.6 * np.sign(problem.system.weights)
    found = shrink(problem, tape)
    assert problem.replay(found.noise[None]).violated.all()
    assert not problem.replay(0.99 * found.noise[None]).violated.any()
    assert found.after < np.linalg.norm(tape)


def test_the_budget_is_kept(weighted):
    problem = weighted(random((25, 3), 2) / 5)
    tape = random((25, 3), 3) + 0.6 * np.sign(problem.system.weights)
    for budget in (2, 3, 40, 111):
        found = shrink(problem, tape, budget)
        assert found.rollouts <= budget
        assert problem.replay(found.noise[None]).violated.all()
    assert shrink(problem, tape, 40).reason.endswith("fails; the budget of rollouts is used up")


class Either:
    """Fails by a number above 2 in channel 0, and less clearly by one above 0.5 in channel 1."""

    noise_size = 3

    def initial(self, noise):
        return self.step({"x": np.zeros(len(noise))}, noise)

    def step(self, state, noise):
        pushed = np.where(noise[:, 0] > 2.0, 10.0, np.where(noise[:, 1] > 0.5, 4.0, 0.0))
        return {"x": np.maximum(state["x"], pushed)}

    def signals(self, state):
        return state


def test_another_order_improves_on_the_greedy_one(monkeypatch):
    problem = avrare.Problem(Either(), avrare.stl("always (x < 3)"), 29)
    tape = random((30, 3))
    tape[:, :2] = 0.0
    tape[3, 0], tape[5, 1] = 2.08, 0.52
    found = shrink(problem, tape)
    assert np.argwhere(found.noise).tolist() == [[5, 1]]
    assert found.reason is None
    monkeypatch.setattr("avrare.analysis.failures.shrink._RESTARTS", 0)
    monkeypatch.setattr("avrare.analysis.failures.shrink.descend", lambda trials, tape, channels: tape)
    assert np.argwhere(shrink(problem, tape).noise).tolist() == [[3, 0]]


def test_the_result_is_rotated_within_its_channels(weighted, monkeypatch):
    weights = np.zeros((30, 3))
    weights[8:12, 1] = 1.0
    weights[20, 2] = 1.9
    tape = np.zeros((30, 3))
    tape[8, 1], tape[22, 2], tape[25, 0] = 5.0, 3.0, 2.0
    found = shrink(weighted(weights), tape)
    assert found.after < 1.7  # the nearest in channel 1 is 4 x 0.75, of norm 1.5; the least of all is 1.2
    assert found.noise.any(axis=0).tolist() == [False, True, False]
    monkeypatch.setattr("avrare.analysis.failures.shrink.descend", lambda trials, tape, channels: tape)
    assert shrink(weighted(weights), tape).after == pytest.approx(3.0, abs=0.01)


def test_chunks_change_no_bit(weighted):
    weights = random((25, 3), 2) / 5
    tape = random((25, 3), 3) + 0.6 * np.sign(weights)
    found = [shrink(weighted(weights, chunk=chunk), tape, 150) for chunk in (1, 7, 4096)]
    for other in found[1:]:
        np.testing.assert_array_equal(other.noise, found[0].noise, strict=True)
        assert other.rollouts == found[0].rollouts


def test_a_tape_that_does_not_fail_is_refused(weighted):
    with pytest.raises(UsageError, match="does not fail"):
        shrink(weighted(np.ones((5, 3))), np.zeros((5, 3)))


@pytest.mark.parametrize("breaks", [{"raises": 1.0}, {"nan": 1.0}])
def test_rollout_errors_are_not_failures(weighted, breaks):
    weights = np.zeros((10, 3))
    weights[4, 0] = 1.0
    weights[6, 1] = 1.0
    tape = np.minimum(random((10, 3), 4), 0.9)
    tape[4, 0], tape[6, 1] = 0.9, 4.0
    problem = weighted(weights, **breaks)
    found = shrink(problem, tape)
    outcome = problem.replay(found.noise[None])
    assert outcome.violated.all()
    assert not outcome.error.any()
    broken = tape.copy()
    broken[2, 0] = 1.5
    with pytest.raises(UsageError, match="does not fail"):
        shrink(problem, broken)


def test_a_stack_that_fails_without_noise_gets_the_noise_that_saves_it(weighted):
    weights = np.zeros((10, 3))
    weights[3, 2] = 1.0
    problem = weighted(weights, "eventually (x > 0.5)")
    tape = random((10, 3))
    tape[3, 2] = -1.0
    found = shrink(problem, tape)
    assert (found.after, found.nonzero, found.ratio) == (0.0, 0, 0.0)
    assert np.argwhere(found.passing_noise).tolist() == [[3, 2]]
    assert found.passing_noise[3, 2] == pytest.approx(0.5, abs=0.01)
    assert not problem.replay(found.passing_noise[None]).violated.any()


def test_a_stack_that_always_fails_has_no_rescue(weighted):
    found = shrink(weighted(np.zeros((4, 3)), "eventually (x > 0.5)"), random((4, 3)))
    assert (found.after, found.passing_noise) == (0.0, None)
