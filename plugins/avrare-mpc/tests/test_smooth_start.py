"""`smooth_start`: the first planned turn rate is tied to the last one driven, in both backends."""

import numpy as np
import pytest

from avrare_mpc.config import MpcConfig
from avrare_mpc.controller import build

WEIGHT = 20_000.0
BACKENDS = [
    "casadi",
    "riccati",
]


def controller(lane_change, smooth, backend):
    options = {"turn_rate_change_weight": WEIGHT, "search": "follow", "backend": backend}
    return build(MpcConfig(smooth_start=smooth, **options), lane_change.scene)


@pytest.fixture(scope="module")
def noise():
    return np.array([0.3, 0.15, 0.3]) * np.random.default_rng(2).standard_normal((1, 9, 3, 3))


@pytest.mark.parametrize("backend", BACKENDS)
def test_driven_turn_rates_jump_less(lane_change, noise, backend):
    largest = []
    for smooth in (False, True):
        drive = lane_change.drive(controller(lane_change, smooth, backend), noise, samples=10)
        driven = np.concatenate([np.zeros((1, 1)), drive.actions[..., 1]], axis=1)
        largest.append(np.abs(np.diff(driven)).max())
        assert drive.memory.fallbacks.sum() == 0
    assert largest[1] < 0.8 * largest[0]


def test_both_backends_find_the_same_plans(lane_change, noise):
    """Plan on the drive of the one, step by step, so that both are given the same."""
    quick, slow = (controller(lane_change, True, backend) for backend in ("riccati", "casadi"))
    drive = lane_change.drive(quick, noise, samples=10)
    pairs = [(quick.act(*given)[1], slow.act(*given)[1]) for given in drive.inputs]
    apart = [np.abs(ours.plan_inputs - theirs.plan_inputs).max() for ours, theirs in pairs]
    assert np.median(apart) < 1e-4
    assert np.mean(np.array(apart) < 2e-3) > 0.8


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_last_turn_rate_counts_only_if_asked_for(lane_change, noise, backend):
    for smooth in (False, True):
        planner = controller(lane_change, smooth, backend)
        memory, ego, prediction = lane_change.drive(planner, noise, samples=7).inputs[-1]
        turned = memory.plan_inputs.copy()
        turned[:, 0, 1] += 0.1  # the last action; the plan that is shifted begins after it
        other = type(memory)(**{**vars(memory), "plan_inputs": turned})
        first, second = (planner.act(given, ego, prediction)[0].yaw_rate for given in (memory, other))
        moved = float(second[0] - first[0])
        assert moved > 0.01 if smooth else moved == 0.0
