"""Where plans start: `search: everywhere` in later steps too, `smooth_start` at the last turn rate driven."""

import casadi as ca
import numpy as np
import pytest

from avrare.base.batch import concatenate
from avrare_mpc.config import MpcConfig
from avrare_mpc.controller import build
from avrare_mpc.nlp import build_problem, pack_parameters
from avrare_mpc.plan import start_of, to_variables


@pytest.fixture(scope="module")
def steps(lane_change):
    """Return what later steps of noisy drives were given, all in one batch."""
    inputs = lane_change.drive(lane_change.follower("casadi"), lane_change.noise(6, 12, seed=4)).inputs
    return tuple(concatenate([step[i] for step in inputs[1:]]) for i in range(3))


@pytest.fixture(scope="module", params=["casadi", "riccati"])
def outcomes(request, lane_change, steps):
    """Return memory after the same steps, of a controller that follows and of one that looks everywhere."""
    configs = (MpcConfig(backend=request.param, search=way) for way in ("follow", "everywhere"))
    return [build(config, lane_change.scene).act(*steps)[1] for config in configs]


def costs(lane_change, steps, memory):
    """Return the costs of the plans, by the programme that defines them."""
    config, (_, ego, prediction) = MpcConfig(), steps
    nlp = build_problem(config, lane_change.scene)
    cost = ca.Function("cost", [nlp.variables, nlp.parameters], [nlp.cost])
    start = start_of(ego)
    parameters = pack_parameters(lane_change.scene, start, prediction.x, prediction.y)
    plans = to_variables(memory.plan_states, memory.plan_inputs)
    return np.array([float(cost(*row)) for row in zip(plans, parameters, strict=True)])


@pytest.mark.slow
def test_plans_are_never_costlier_and_sometimes_much_cheaper(lane_change, steps, outcomes):
    follow, everywhere = (costs(lane_change, steps, memory) for memory in outcomes)
    assert (everywhere <= follow * (1.0 + 1e-5)).all()
    assert (everywhere < 0.9 * follow).sum() >= 2


@pytest.mark.slow
def test_it_counts_the_old_plan_and_each_initial_guess(steps, outcomes):
    follow, everywhere = ((memory.solves - steps[0].solves).tolist() for memory in outcomes)
    assert set(follow) == {1}
    assert set(everywhere) == {5}


BACKENDS = ["casadi", "riccati"]


def controller(lane_change, smooth, backend):
    return lane_change.follower(backend, turn_rate_change_weight=20_000.0, smooth_start=smooth, stops=True)


@pytest.fixture(scope="module")
def noise(lane_change):
    return lane_change.noise(1, 10, seed=2)


@pytest.mark.parametrize("backend", BACKENDS)
def test_driven_turn_rates_jump_less(lane_change, noise, backend):
    largest = []
    for smooth in (False, True):
        drive = lane_change.drive(controller(lane_change, smooth, backend), noise)
        driven = np.concatenate([np.zeros((1, 1)), drive.actions[..., 1]], axis=1)
        largest.append(np.abs(np.diff(driven)).max())
        assert drive.memory.fallbacks.sum() == 0
    assert largest[1] < 0.8 * largest[0]


def test_both_backends_find_the_same_plans(lane_change, noise):
    """Plan on the drive of the one, step by step, so that both are given the same."""
    quick, slow = (controller(lane_change, True, backend) for backend in ("riccati", "casadi"))
    drive = lane_change.drive(quick, noise)
    pairs = [(quick.act(*given)[1], slow.act(*given)[1]) for given in drive.inputs]
    apart = [np.abs(ours.plan_inputs - theirs.plan_inputs).max() for ours, theirs in pairs]
    assert np.median(apart) < 1e-4
    assert np.mean(np.array(apart) < 2e-3) > 0.8


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_last_turn_rate_counts_only_if_asked_for(lane_change, noise, backend):
    for smooth in (False, True):
        planner = controller(lane_change, smooth, backend)
        memory, ego, prediction = lane_change.drive(planner, noise[:, :6]).inputs[-1]
        turned = memory.plan_inputs.copy()
        turned[:, 0, 1] += 0.1  # the last action; the plan that is shifted begins after it
        other = type(memory)(**{**vars(memory), "plan_inputs": turned})
        first, second = (planner.act(given, ego, prediction)[0].yaw_rate for given in (memory, other))
        moved = float(second[0] - first[0])
        assert moved > 0.01 if smooth else moved == 0.0
