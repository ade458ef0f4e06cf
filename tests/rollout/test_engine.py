"""The engine: rows, joins, cuts into chunks, cost and counters, and drives that end before the others."""

import itertools

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.base import batch
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request, Rollouts
from avrare.testing import faulty_systems as systems
from rollout_requests import fresh

STEPS = 20
NOISE = NoiseSource(9, 1)


def problem(system=None, formula="always (x < 0.5)", **keywords):
    return avrare.Problem(system or systems.Walk(), avrare.stl(formula), steps=STEPS, **keywords)


def branches(parents, start):
    """Return a request that branches row i of ``parents`` (its carries are kept) at start[i], in stage 1."""
    carries = {t: carry for t, _, carry in parents.carries}
    pairs = tuple((int(t), batch.take(carries[int(t)], np.flatnonzero(start == t))) for t in np.unique(start))
    zeros = np.zeros(len(start), dtype=np.int64)
    return Request(zeros, zeros + 1, np.arange(len(start)), start, pairs)


def assert_same(one, other):
    for name in ("robustness", "violated", "error", "scores"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@pytest.mark.parametrize("system", [systems.Walk(), odd_systems.NestedWalk(), systems.Fragile("raise", 1.5)])
def test_rows_do_not_depend_on_their_neighbours(system):
    source = NoiseSource(9, system.noise_size)
    task = problem(system, "eventually[0:5] (x > 0.1) and historically (x > -9)")
    together = task.simulate(source, fresh(40))
    for cuts in ([0, 1, 40], [0, 13, 26, 40], list(range(41))):
        parts = [task.simulate(source, fresh(40).slice(a, b)) for a, b in itertools.pairwise(cuts)]
        assert_same(together, Rollouts.join(parts))


def test_branches_continue_their_parents():
    task = problem(formula="always (x < 0.5) or eventually[3:7] (x > 0)")
    parents = task.simulate(NOISE, fresh(12, keep_carries=True))
    start = np.sort(np.arange(12) * 7 % (STEPS + 1))
    request = branches(parents, start)
    children = task.simulate(NOISE, request)
    old = NOISE.normals(0, 0, np.arange(12)[:, None], np.arange(STEPS + 1))
    new = NOISE.normals(0, 1, np.arange(12)[:, None], np.arange(STEPS + 1))
    tape = np.where((np.arange(STEPS + 1) <= start[:, None])[..., None], old, new)
    replayed = task.simulate(NOISE, Request.replay(tape))
    np.testing.assert_array_equal(children.robustness, replayed.robustness)
    np.testing.assert_array_equal(children.violated, replayed.violated)
    fresh_part = np.arange(STEPS + 1) >= start[:, None]
    np.testing.assert_array_equal(children.scores[fresh_part], replayed.scores[fresh_part])
    assert np.isneginf(children.scores[~fresh_part]).all()
    assert children.simulated_steps == (STEPS - start).sum()
    halves = [task.simulate(NOISE, request.slice(a, b)) for a, b in ((0, 5), (5, 12))]
    assert_same(children, Rollouts.join(halves))


def test_a_start_and_branches_in_one_request():
    task = problem()
    parents = task.simulate(NOISE, fresh(4, keep_carries=True))
    request = branches(parents, np.array([0, 0, 5, 20]))
    mixed = Request(
        np.zeros(6, dtype=np.int64), np.array([0, 0, 1, 1, 1, 1]), np.array([0, 1, 0, 1, 2, 3]),
        np.array([-1, -1, 0, 0, 5, 20]), request.carries,
    )  # fmt: skip
    outcome = task.simulate(NOISE, mixed)
    apart = task.simulate(NOISE, fresh(4).slice(0, 2)), task.simulate(NOISE, request)
    assert_same(outcome, Rollouts.join(list(apart)))
    parts = [task.simulate(NOISE, mixed.slice(at, at + 1)) for at in range(6)]
    assert_same(outcome, Rollouts.join(parts))


def test_unscored_rollouts_carry_no_scores():
    scored, unscored = (problem().simulate(NOISE, fresh(30), scored=flag) for flag in (True, False))
    assert unscored.scores.shape == (30, 0)
    np.testing.assert_array_equal(scored.robustness, unscored.robustness)
    np.testing.assert_array_equal(scored.scores[:, -1], -scored.robustness[:, 0])


def test_scores_never_fall():
    scores = problem(formula="eventually (x > 0.3)").simulate(NOISE, fresh(30)).scores
    assert (np.diff(scores, axis=1) >= 0).all()


def test_counters_of_a_branch_are_its_own():
    task = problem(odd_systems.Odometer())
    parents = task.simulate(NOISE, fresh(3, keep_carries=True))
    assert parents.counts["steps"].tolist() == [STEPS] * 3
    children = task.simulate(NOISE, branches(parents, np.array([0, 8, 20])))
    assert children.counts["steps"].tolist() == [20, 12, 0]
    assert children.simulated_steps == 32


def test_every_row_passed_to_step_is_counted():
    system = systems.Counting(systems.Walk())
    outcome = problem(system).simulate(NOISE, fresh(17))
    assert outcome.simulated_steps == system.rows == 17 * STEPS


class Climb(systems.Walk):
    """x = 0, 1, 2, ...; a rollout whose first number is positive ends at x = 3."""

    def initial(self, noise):
        return {"x": np.zeros(len(noise)), "ends": noise[:, 0] > 0.0}

    def step(self, state, noise):
        return {**state, "x": state["x"] + 1.0}

    def ended(self, state):
        return state["ends"] & (state["x"] >= 3.0)


@pytest.mark.parametrize(
    "formula",
    [
        "always (x < 5)",
        "always (x < 5 or once[0, 3 samples] (x > 100))",
        "always ((x < 5) since (x < 1))",
        "always (x < 5 or always[2, 4 samples] (x > 100))",
    ],
)
def test_samples_after_the_end_count_for_nothing(formula):
    problem = avrare.Problem(Climb(), avrare.stl(formula), steps=8)
    noise = np.zeros((6, 9, 1))
    noise[::2, 0] = 1.0
    rollouts = problem.replay(noise)
    assert rollouts.violated[:, 0].tolist() == [False, True] * 3
    assert not rollouts.error.any()
