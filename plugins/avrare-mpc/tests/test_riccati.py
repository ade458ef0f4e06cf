"""The riccati backend beside the casadi backend, compiled or not."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from avrare.base.batch import concatenate, take
from avrare_mpc.config import MpcConfig
from avrare_mpc.plan import shift, start_of
from avrare_mpc.riccati import jit
from avrare_mpc.riccati.solver import RiccatiSolver


@pytest.fixture(scope="module")
def fast(lane_change):
    return lane_change.follower("riccati")


@pytest.fixture(scope="module")
def situations(lane_change):
    """Return inputs of ``act`` from noisy drives of the casadi backend, one row each, and its actions."""
    controller = lane_change.follower("casadi")
    drive = lane_change.drive(controller, lane_change.noise(4, 13, seed=5))
    given = tuple(concatenate([step[i] for step in drive.inputs]) for i in range(3))
    return given, controller.act(*given)


def given_to_the_solver(lane_change, situations):
    memory, ego, prediction = situations[0]
    start = start_of(ego)
    guesses = shift(memory.plan_states, memory.plan_inputs, lane_change.scene.dt)[1]
    rows = np.flatnonzero(memory.solved)
    return start, prediction.x, prediction.y, rows, guesses[rows]


def test_riccati_agrees_with_casadi(fast, situations):
    given, (action, memory) = situations
    found, later = fast.act(*given)
    assert (later.fallbacks == memory.fallbacks).all()
    assert np.array_equal(later.solves, memory.solves)
    same = np.abs(found.acceleration - action.acceleration) < 1e-4
    same &= np.abs(found.yaw_rate - action.yaw_rate) < 1e-4
    assert same.mean() > 0.85  # elsewhere another local minimum
    np.testing.assert_allclose(later.plan_states[same], memory.plan_states[same], atol=2e-3)
    assert np.abs(later.plan_inputs[..., 0]).max() <= 11.5
    assert np.abs(later.plan_inputs[..., 1]).max() <= 0.5


def test_compiled_and_plain_python_agree(lane_change, situations, interpreted):
    start, x, y, rows, guesses = given_to_the_solver(lane_change, situations)
    some = slice(0, None, 6)
    compiled = RiccatiSolver(MpcConfig(), lane_change.scene).solve(start, x, y, rows[some], guesses[some])
    twin = interpreted(MpcConfig(), lane_change.scene).solve(start, x, y, rows[some], guesses[some])
    assert compiled.feasible.all()
    assert np.array_equal(compiled.iterations, twin.iterations)
    assert np.array_equal(twin.cost, compiled.cost)
    assert np.array_equal(twin.inputs, compiled.inputs)


def test_rows_do_not_depend_on_their_neighbours(fast, situations):
    memory, ego, prediction = situations[0]
    action, later = fast.act(memory, ego, prediction)
    for index in (np.array([0]), np.array([7]), np.array([40, 3, 3])):
        alone, alone_later = fast.act(*(take(part, index) for part in (memory, ego, prediction)))
        assert np.array_equal(alone.acceleration, action.acceleration[index])
        assert np.array_equal(alone_later.plan_states, later.plan_states[index])
        assert np.array_equal(alone_later.start_policy, later.start_policy[index])


def test_the_noise_free_rollout_changes_lane_like_that_of_casadi(lane_change, fast, quiet):
    controller, drive = quiet
    ours = lane_change.drive(fast, np.zeros((1, 39, 3, 3)))
    np.testing.assert_allclose(ours.states[:, :6], drive.states[:, :6], atol=1e-5)
    assert np.abs(ours.states[..., 1] - drive.states[..., 1]).max() < 0.3
    assert (lane_change.gaps(ours.states) > 0.5).all()
    assert fast.counts(ours.memory) == controller.counts(drive.memory)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"v_goal": 40.0, "speed_max": 24.0},
        {"heading_max": 0.1},
        {"lateral_lead": "speed", "heading_weight": 20.0},
        {"lanes": [0, 1, 2], "y_goal": 3.0, "sharpness": 4.0},
        {"lanes": [2], "y_goal": 5.25, "turn_rate_change_weight": 2000.0},
        {"horizon": 12, "obstacle_weight": 50.0, "y_penalty": 1e4, "clearance_x": 1.0},
        {"lateral_acceleration_max": 3.0, "v_goal": 40.0, "speed_max": 24.0},
        {"acceleration_max": 2.0, "turn_rate_max": 0.1, "braking_weight": 0.0, "y_margin": 0.0},
    ],
)
def test_every_option_has_the_same_meaning(lane_change, options):
    """Compare first plans, where both backends keep the cheapest of several searches."""
    slow, quick = (lane_change.follower(backend, **options) for backend in ("casadi", "riccati"))
    ego, prediction = lane_change.first_situations(8, 17.0, slow.horizon)
    action, expected = slow.act(slow.start(len(ego.x)), ego, prediction)
    found, later = quick.act(quick.start(len(ego.x)), ego, prediction)
    assert later.solved.all()
    assert np.array_equal(later.solves, expected.solves)
    same = np.abs(later.plan_inputs - expected.plan_inputs).max(axis=(1, 2)) < 2e-3
    assert same.mean() >= 0.75
    np.testing.assert_allclose(found.acceleration[same], action.acceleration[same], atol=1e-4)


def test_bounds_of_speed_and_heading_hold(lane_change):
    controller = lane_change.follower("riccati", speed_max=22.0, heading_max=0.06)
    ego, prediction = lane_change.first_situations(8, 17.0)
    speed, heading = np.minimum(ego.speed, 22.0), np.clip(ego.heading, -0.06, 0.06)
    ego = dataclasses.replace(ego, speed=speed, heading=heading)
    _, memory = controller.act(controller.start(len(ego.x)), ego, prediction)
    assert memory.solved.all()
    assert memory.plan_states[:, :, 2].max() == pytest.approx(22.0, abs=1e-5)
    assert np.abs(memory.plan_states[:, :, 3]).max() == pytest.approx(0.06, abs=1e-5)


def test_without_numba_it_warns_and_works(lane_change, plain, quiet):
    memory, ego, prediction = quiet[1].inputs[5]
    with pytest.warns(UserWarning, match="numba is not installed"):
        search = plain.solver.RiccatiSearch(MpcConfig(backend="riccati"), lane_change.scene)
    assert not plain.jit.COMPILED
    start = start_of(ego)
    old = memory.plan_states, memory.plan_inputs
    outcome = search(memory.solved, start, old, (prediction.x, prediction.y))
    assert outcome.feasible.tolist() == [True]
    assert outcome.states[0, 0].tolist() == start[0, :4].tolist()


def test_where_no_cache_can_be_written_kernels_are_compiled_without(monkeypatch):
    asked = []

    def njit(**options):
        asked.append(options.get("cache", False))
        if options.get("cache"):
            raise RuntimeError("no locator available")
        return lambda function: function

    monkeypatch.setattr(jit.numba, "njit", njit)
    assert jit.entry(start_of) is start_of
    assert asked == [True, False]


def test_cached_machine_code_depends_on_the_kernels_alone(plain):
    kernels = ("jit", "lanes", "vectors", "functions", "cost", "sweep", "newton", "batch")
    for module in (jit, plain.jit):
        assert {Path(name).stem for name in module._SOURCES} == set(kernels)


@pytest.mark.parametrize("damage", [b"", b"\0" * 100])
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_truncated_machine_code_is_compiled_again(tmp_path, monkeypatch, damage, ending):
    monkeypatch.setattr(jit.numba.config, "CACHE_DIR", str(tmp_path))

    def double(x):
        return 2.0 * x

    assert jit.entry(double)(2.0) == 4.0
    (file,) = tmp_path.rglob(f"*.{ending}")
    whole = file.read_bytes()
    file.write_bytes(damage)
    assert jit.entry(double)(2.0) == 4.0
    assert len(file.read_bytes()) == len(whole)
    assert jit.entry(double)(3.0) == 6.0
