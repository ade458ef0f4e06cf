"""`lateral_acceleration_max`: |speed x turn rate| stays below it, planned and driven, in both backends."""

import dataclasses

import numpy as np
import pytest

from avrare.driving import Road
from avrare_mpc.config import MpcConfig, TrajectoryPlan
from avrare_mpc.riccati.lanes import WIDTH
from avrare_mpc.riccati.solver import programme
from avrare_mpc.trajectory import plan_trajectory

LIMIT = 4.0
BACKENDS = ["casadi", "riccati"]


def planned(memory):
    return memory.plan_states[:, :-1, 2] * memory.plan_inputs[..., 1]


@pytest.mark.slow
def test_both_backends_find_the_same_plan_at_the_bound(lane_change):
    given, found = lane_change.first_situations(6, 10.0), []
    for backend in BACKENDS:
        controller = lane_change.follower(backend, lateral_acceleration_max=LIMIT)
        found.append(controller.act(controller.start(6), *given)[1])
    expected, ours = found
    assert ours.solved.all()
    for memory in found:
        lateral = np.abs(planned(memory))
        assert (lateral.max(axis=1) > 0.999 * LIMIT).all()
        assert lateral.max() <= LIMIT + 1e-6
    same = np.abs(ours.plan_inputs - expected.plan_inputs).max(axis=(1, 2)) < 2e-3
    assert same.mean() > 0.8
    np.testing.assert_allclose(ours.plan_inputs[same, 0], expected.plan_inputs[same, 0], atol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_driven_lateral_acceleration_keeps_the_bound(lane_change, backend):
    noise = lane_change.noise(1, 12, seed=2)
    free = lane_change.drive(lane_change.follower(backend), noise)
    drive = lane_change.drive(lane_change.follower(backend, lateral_acceleration_max=LIMIT), noise)
    driven = [np.abs(each.states[:, :-1, 2] * each.actions[..., 1]).max(axis=1) for each in (free, drive)]
    assert (driven[0] > 8.0).all()
    assert (driven[1] > 0.99 * LIMIT).all()
    assert (driven[1] <= LIMIT + 1e-6).all()
    assert drive.memory.fallbacks.sum() == 0


@pytest.mark.parametrize("backend", BACKENDS)
def test_an_old_plan_is_followed_within_the_bound_at_another_speed(lane_change, backend):
    controller = lane_change.follower(backend, lateral_acceleration_max=LIMIT)
    ego, prediction = lane_change.first_situations(1, 10.0)
    _, memory = controller.act(controller.start(1), ego, prediction)
    step = 3 + int(np.abs(planned(memory))[0, 3:].argmax())
    unseen = lane_change.blind(prediction)
    for _ in range(step):  # at the end the plan's turn rate at that step
        faster = dataclasses.replace(ego, speed=ego.speed + 10.0)
        action, memory = controller.act(memory, faster, unseen)
    assert memory.fallbacks[0] == step
    assert np.abs(faster.speed * memory.plan_inputs[:, 0, 1])[0] > 1.2 * LIMIT
    assert abs(faster.speed * action.yaw_rate)[0] == pytest.approx(LIMIT)
    action, _ = controller.act(memory, dataclasses.replace(ego, speed=np.zeros(1)), unseen)
    assert np.isfinite(action.yaw_rate).all()


@pytest.mark.parametrize("speed", [20.0, 0.0, -20.0, 0.5])
def test_a_trial_stays_strictly_inside_whatever_its_direction(lane_change, plain, speed):
    rng, config = np.random.default_rng(1), MpcConfig(horizon=8, lateral_acceleration_max=LIMIT)
    p = programme(config, lane_change.scene)
    _, path, trial, work = plain.values.new_memory(8, 3)
    path.states[:4] = np.reshape([0.0, 1.75, speed, 0.0], (4, 1))
    path.inputs[:] = np.reshape([1.0, 0.1] * rng.uniform(-1.0, 1.0, (8, 2)), (16, 1))
    bounds, one, everywhere = plain.values.Bounds(hard=3, soft=1), np.ones(WIDTH), np.full(WIDTH, True)
    with np.errstate(divide="ignore"):
        plain.newton.follow(p, path, path, work, bounds, one, everywhere)
    for size in (1e-3, 1.0, 1e6):
        work.gains[:] = size * rng.standard_normal(work.gains.shape)
        with np.errstate(divide="ignore"):
            plain.newton.follow(p, path, trial, work, bounds, one, ~everywhere)
        gap, before = (
            LIMIT - np.abs(each.states[:-4].reshape(8, 4, -1)[:, 2] * each.inputs.reshape(8, 2, -1)[:, 1])
            for each in (trial, path)
        )
        assert (gap > 0.0049 * before).all()
        assert (np.abs(trial.inputs[::2]) < p.acceleration_max).all()
        assert (np.abs(trial.inputs[1::2]) < p.turn_rate_max).all()


def test_scripted_cars_keep_it_too():
    plan = {"steps": 40, "y_goal": 5.25, "schedule": [{"from_step": 0, "to_step": 39, "lane": 2}]}
    road = Road((-1.75, 1.75, 5.25), 3.5)
    peaks = []
    for limit in (None, 2.0):
        options = TrajectoryPlan.model_validate({**plan, "lateral_acceleration_max": limit})
        car = plan_trajectory(options, 0.0, 1.75, 20.0, 0.0, road, 0.1)
        peaks.append(np.abs(car.speed[:-1] * np.diff(car.heading) / 0.1).max())
    assert peaks[0] > 4.0
    assert peaks[1] == pytest.approx(2.0, abs=1e-6)
