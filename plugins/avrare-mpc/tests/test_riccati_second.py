"""The second, rough search: of two minima the cheaper one."""

import numpy as np
import pytest

from avrare.base.batch import concatenate
from avrare_mpc.config import MpcConfig
from avrare_mpc.plan import shift, start_of
from avrare_mpc.riccati import solver as module
from avrare_mpc.riccati.batch import solve_all
from avrare_mpc.riccati.solver import BETTER, NEAR, QUICK, RiccatiSolver

HASTY = QUICK._replace(iterations=1)
"""An attempt that always fails."""
FIELDS = ("states", "inputs", "cost", "feasible", "retried", "iterations")


@pytest.fixture(scope="module")
def programmes(lane_change):
    """Return arguments of ``solve``: every later step of noisy drives."""
    drive = lane_change.drive(lane_change.follower("riccati"), lane_change.noise(24, 31, seed=8))
    memory, ego, prediction = (concatenate([step[i] for step in drive.inputs[1:]]) for i in range(3))
    start = start_of(ego)
    guesses = shift(memory.plan_states, memory.plan_inputs, lane_change.scene.dt)[1]
    return start, prediction.x, prediction.y, np.arange(len(start)), guesses


@pytest.fixture(scope="module")
def both(lane_change, programmes):
    """Return solutions with the second search and without it."""
    solvers = (RiccatiSolver(MpcConfig(), lane_change.scene, near=near) for near in (NEAR, None))
    return tuple(solver.solve(*programmes) for solver in solvers)


@pytest.mark.slow
def test_the_second_search_is_never_costlier_and_sometimes_cheaper(both):
    found, alone = both
    cheaper = found.cost < alone.cost
    assert found.feasible.all()
    assert (found.cost <= alone.cost).all()
    assert 3 <= cheaper.sum() < 0.1 * len(cheaper)
    assert (found.cost[cheaper] < (1.0 - BETTER / 2) * alone.cost[cheaper]).all()
    for name in ("states", "inputs", "cost", "retried"):
        assert np.array_equal(getattr(found, name)[~cheaper], getattr(alone, name)[~cheaper])


def test_cost_and_states_are_those_of_the_inputs_that_are_kept(lane_change, programmes, both):
    """Start again from its own plan: a search that is already there stays."""
    start, x, y, rows, _ = programmes
    cheaper = np.flatnonzero(both[0].cost < both[1].cost)
    inputs = both[0].inputs[cheaper]
    again = RiccatiSolver(MpcConfig(), lane_change.scene, quick=module.FROM_NEAR, near=None)
    solution = again.solve(start, x, y, rows[cheaper], inputs)
    np.testing.assert_allclose(solution.cost, both[0].cost[cheaper], rtol=1e-6)
    np.testing.assert_allclose(solution.states, both[0].states[cheaper], atol=1e-3)


def test_iterations_of_the_second_search_are_counted(both, programmes, lane_change):
    found, alone = both
    rough = RiccatiSolver(MpcConfig(), lane_change.scene, NEAR, NEAR, near=None).solve(*programmes)
    spent = found.iterations - alone.iterations
    assert (spent >= 1).all()
    settled = ~rough.retried & (rough.cost >= alone.cost)  # nothing to finish: the rough search is all
    assert settled.mean() > 0.5
    assert np.array_equal(spent[settled], rough.iterations[settled])
    cheaper = found.cost < alone.cost
    assert (spent[cheaper] > rough.iterations[cheaper]).all()


def test_the_second_search_helps_where_the_first_fails(lane_change, programmes):
    """Count the first attempt as failed all the same."""
    hasty = RiccatiSolver(MpcConfig(), lane_change.scene, quick=HASTY, patient=HASTY).solve(*programmes)
    alone = RiccatiSolver(MpcConfig(), lane_change.scene, HASTY, HASTY, near=None).solve(*programmes)
    assert not alone.feasible.any()
    assert hasty.feasible.all()
    assert hasty.retried.all()
    assert np.isfinite(hasty.cost).all()


def with_rough(monkeypatch, change):
    """Apply ``change`` to what the rough search answers; returns a list of its iterations, to be filled."""
    run, spent = RiccatiSolver._run, []

    def changed(self, bounds, tuning, *rest):
        answer = run(self, bounds, tuning, *rest)
        if tuning is NEAR:
            change(answer)
            spent.append(answer.iterations.copy())
        return answer

    monkeypatch.setattr(RiccatiSolver, "_run", changed)
    return spent


def test_a_rough_plan_that_is_nan_is_ignored(monkeypatch, lane_change, programmes, both):
    def lose(answer):
        answer.inputs[:], answer.cost[:] = np.nan, -1.0  # it looks promising

    spent = with_rough(monkeypatch, lose)
    found = RiccatiSolver(MpcConfig(), lane_change.scene).solve(*programmes)
    for name in ("states", "inputs", "cost", "feasible", "retried"):
        assert np.array_equal(getattr(found, name), getattr(both[1], name))
    assert np.array_equal(found.iterations, both[1].iterations + spent[0])


def test_rows_are_the_same_bits_in_any_batch(lane_change, programmes, both):
    *given, rows, guesses = programmes
    solver = RiccatiSolver(MpcConfig(), lane_change.scene)
    cheaper = np.flatnonzero(both[0].cost < both[1].cost)
    for index in (*cheaper[:4, None], cheaper, rows[::-7], np.array([5, 5, cheaper[0]])):
        part = solver.solve(*given, rows[index], guesses[index])
        for name in FIELDS:
            assert np.array_equal(getattr(part, name), getattr(both[0], name)[index])


def test_of_several_guesses_the_best_counts(lane_change, programmes, both):
    """Take guesses each of which, one after another, finds nothing that is cheaper."""
    *given, rows, guesses = programmes
    solver, index = RiccatiSolver(MpcConfig(), lane_change.scene), np.arange(0, len(rows), 5)
    turns = guesses[rows[index]] + np.array([[0.0, 0.3], [0.0, -0.3], [-3.0, 0.0]])[:, None, None]
    together, apart = (solver.solve(*given, rows, guesses) for _ in range(2))
    solver.improve(together, index, *given, rows[index], np.stack(list(turns), axis=1))
    for turn in turns:
        solver.improve(apart, index, *given, rows[index], turn[:, None])
    assert (together.cost < both[0].cost).any()
    assert (together.cost <= apart.cost * (1.0 + BETTER)).all()
    assert together.feasible.all()


def test_other_memory_layouts_are_not_compiled_again(lane_change, programmes, both):
    start, x, y, rows, guesses = programmes
    known = len(solve_all.compiled.signatures)
    apart = np.asfortranarray(x)
    apart.flags.writeable = False
    found = RiccatiSolver(MpcConfig(), lane_change.scene).solve(
        start, apart, y, rows[::5].astype(np.int32), np.asfortranarray(guesses)[::5]
    )
    assert np.array_equal(found.cost, both[0].cost[::5])
    assert len(solve_all.compiled.signatures) == known
