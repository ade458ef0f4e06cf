import dataclasses

import numpy as np
import pytest

from avrare.base.batch import concatenate
from avrare.base.errors import UsageError
from avrare.driving import Prediction, Vehicles
from avrare_mpc.config import MpcConfig
from avrare_mpc.controller import build
from avrare_mpc.plan import initial_guesses


def test_the_noise_free_rollout_changes_lane_between_the_others(lane_change, quiet):
    controller, drive = quiet
    states = drive.states[0]
    assert states[-1, 1] > 5.0
    assert states[:, 1].max() < 5.763 + 1e-6
    assert (lane_change.gaps(drive.states) > 0.5).all()
    counts = controller.counts(drive.memory)
    assert counts["solves"].tolist() == [4 + 38]
    assert counts["fallback_solves"].tolist() == [0]


def test_action_is_the_first_input_and_the_plan_starts_here(quiet):
    controller, drive = quiet
    for step, (memory, ego, prediction) in enumerate(drive.inputs[:5]):
        action, later = controller.act(memory, ego, prediction)
        assert action.acceleration[0] == later.plan_inputs[0, 0, 0]
        assert action.yaw_rate[0] == later.plan_inputs[0, 0, 1]
        np.testing.assert_allclose(later.plan_states[0, 0], drive.states[0, step], atol=1e-6)
        np.testing.assert_allclose(later.plan_states[0, 1], drive.states[0, step + 1], atol=1e-6)


@pytest.mark.parametrize("backend", ["casadi", "riccati"])
def test_a_vehicle_at_infinity_does_not_exist(lane_change, backend):
    scene, config = lane_change.scene, MpcConfig(backend=backend, search="follow", stops=False)
    fields = ("names", "lengths", "widths", "moving")
    without = dataclasses.replace(scene, **{name: getattr(scene, name)[1:] for name in fields})
    ego = Vehicles(*(np.array([value]) for value in (17.149, 1.75, 0.0, 21.6, 0.0)))
    seen = lane_change.predict(0, np.zeros((1, 3, 3)))
    unknown = Prediction(seen.x.copy(), seen.y.copy())
    unknown.x[:, 0] = unknown.y[:, 0] = np.inf
    plans = []
    for world, prediction in (
        (scene, seen), (scene, unknown), (without, Prediction(seen.x[:, 1:], seen.y[:, 1:]))
    ):  # fmt: skip
        controller = build(config, world)
        plans.append(controller.act(controller.start(1), ego, prediction)[1])
        assert plans[-1].fallbacks.tolist() == [0]
    known, hidden, absent = (plan.plan_states for plan in plans)
    np.testing.assert_array_equal(hidden, absent)
    assert np.abs(known - hidden).max() > 0.5


def test_a_prediction_that_is_not_a_number_is_a_failed_search(lane_change):
    controller = lane_change.follower("riccati")
    ego, seen = lane_change.first_situations(1, 17.0)
    seen.x[:, 0] = np.nan
    assert controller.act(controller.start(1), ego, seen)[1].fallbacks.tolist() == [1]


def test_noisy_rollouts_are_finite_and_inside_the_bounds(lane_change):
    controller = lane_change.follower("casadi")
    drive = lane_change.drive(controller, lane_change.noise(3, 25, seed=5))
    assert np.isfinite(drive.states).all()
    assert np.abs(drive.actions[..., 0]).max() <= 11.5 + 1e-6
    assert np.abs(drive.actions[..., 1]).max() <= 0.5 + 1e-6
    assert drive.states[..., 1].max() < 5.763 + 0.05
    assert controller.counts(drive.memory)["fallback_solves"].sum() == 0


def test_a_plant_outside_the_lateral_bounds_comes_back(lane_change, quiet):
    controller, drive = quiet
    memory, ego, prediction = drive.inputs[20]
    outside = dataclasses.replace(ego, y=np.array([6.3]))
    _, later = controller.act(memory, outside, prediction)
    assert later.fallbacks[0] == memory.fallbacks[0]
    assert later.plan_states[0, 0, 1] == pytest.approx(6.3, abs=1e-6)
    assert later.plan_states[0, -1, 1] <= 5.763 + 1e-3


@pytest.mark.parametrize("backend", ["casadi", "riccati"])
def test_failures_follow_the_old_plan_then_brake(lane_change, quiet, backend):
    controller, (memory, ego, prediction) = lane_change.follower(backend), quiet[1].inputs[10]
    plan, blind = memory.plan_inputs[0], lane_change.blind(prediction)
    for step in range(1, controller.horizon):
        action, memory = controller.act(memory, ego, blind)
        assert (action.acceleration[0], action.yaw_rate[0]) == tuple(plan[step])
        assert memory.solved[0]
    action, memory = controller.act(memory, ego, blind)
    assert (action.acceleration[0], action.yaw_rate[0]) == (-11.5, 0.0)
    assert not memory.solved[0]
    assert controller.counts(memory)["fallback_solves"].tolist() == [20]
    action, memory = controller.act(memory, ego, prediction)
    assert memory.solved[0]
    assert memory.age[0] == 0


@pytest.mark.parametrize(("speed", "braking"), [(21.6, -11.5), (0.5, -5.0), (0.0, 0.0), (np.nan, -11.5)])
def test_a_failure_without_a_plan_brakes_to_a_stop(lane_change, quiet, speed, braking):
    controller, drive = quiet
    _, ego, prediction = drive.inputs[0]
    ego = dataclasses.replace(ego, speed=np.array([speed]))
    action, memory = controller.act(controller.start(1), ego, lane_change.blind(prediction))
    assert action.acceleration[0] == braking
    assert action.yaw_rate[0] == 0.0
    assert memory.fallbacks[0] == 1
    assert memory.start_policy[0] == -1


def test_a_failing_row_does_not_affect_the_others(quiet):
    controller, drive = quiet
    memory, ego, prediction = (concatenate([part, part]) for part in drive.inputs[7])
    x = prediction.x.copy()
    x[1] = np.nan
    action, later = controller.act(memory, ego, Prediction(x=x, y=prediction.y))
    good, _ = controller.act(*drive.inputs[7])
    assert action.acceleration[0] == good.acceleration[0]
    assert (later.fallbacks - memory.fallbacks).tolist() == [0, 1]


def test_absurd_states_give_finite_actions_and_are_counted(quiet):
    controller, drive = quiet
    memory, ego, prediction = drive.inputs[7]
    absurd = dataclasses.replace(ego, speed=np.array([300.0]))  # beyond what the bounds can reach
    action, later = controller.act(memory, absurd, prediction)
    assert np.isfinite([action.acceleration[0], action.yaw_rate[0]]).all()
    assert later.fallbacks[0] == 1
    assert later.retries[0] == memory.retries[0] + 1


def test_initial_guesses_reach_their_lanes():
    states, inputs = initial_guesses(np.array([[17.0, 1.75, 21.6, 0.0]]), (1.75, 5.25), 20, 0.1)
    assert states.shape == (1, 4, 21, 4)
    np.testing.assert_allclose(states[0, :, -1, 1], [1.75, 1.75, 5.25, 5.25])
    np.testing.assert_allclose(states[0, :, -1, 2], [21.6, 15.6, 21.6, 15.6])
    braking = np.array([[0.0], [-3.0], [0.0], [-3.0]])
    np.testing.assert_allclose(inputs[0, :, :, 0], np.repeat(braking, 20, axis=1), atol=1e-9)


def test_predictions_must_be_there_and_long_enough(quiet):
    controller, drive = quiet
    memory, ego, prediction = drive.inputs[0]
    with pytest.raises(UsageError, match="needs predictions"):
        controller.act(memory, ego, None)
    with pytest.raises(UsageError, match="20 predicted steps"):
        controller.act(memory, ego, Prediction(x=prediction.x[..., :20], y=prediction.y[..., :20]))


def test_solvers_are_silent(lane_change, quiet, capfd):
    controller, drive = quiet
    memory, ego, prediction = drive.inputs[3]
    controller.act(memory, dataclasses.replace(ego, speed=np.array([300.0])), prediction)
    controller.act(memory, ego, lane_change.blind(prediction))
    assert capfd.readouterr() == ("", "")
