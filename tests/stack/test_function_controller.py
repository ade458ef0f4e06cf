"""Controller ``function``: what it sees and returns, for one rollout or for all, and its mistakes."""

from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare.analysis.check import validation
from avrare.base.errors import AvrareError, UsageError
from avrare.cli.main import main
from avrare.driving import Action, ObservingEgo, Prediction, Road, Scene, Vehicles
from avrare.scenario.fingerprint import fingerprint
from avrare.stack.python_file import EXAMPLE, FunctionConfig, build_function

SCENE = Scene(
    dt=0.5, road=Road(lane_centres=(0.0, 3.5), lane_width=3.5), ego_length=4.0, ego_width=2.0,
    names=("near", "lost"), lengths=np.array([4.0, 4.0]), widths=np.array([2.0, 2.0]),
    moving=np.array([True, True]),
)  # fmt: skip
NEW = ["new", "scenario", "cart", "--simulator", "gymnasium", "--set", "env=Pendulum-v1"]
SEEN = """\
def act(o):
    car = o.others["near"]
    assert set(o.others) == {"near"} or len(o.ego.x) == 3
    return car.speed_x - o.ego.speed, car.y / o.scene.dt
"""


def ego(n):
    return Vehicles(*(np.linspace(low, low + 1.0, n) for low in (0.0, 10.0, 20.0, 30.0, 40.0)))


def prediction(n):
    x, y = np.full((n, 2, 2), np.inf), np.full((n, 2, 2), np.inf)
    x[:, 0], y[:, 0] = [50.0, 54.0], 1.5
    return Prediction(x, y)


@pytest.fixture
def controller(tmp_path):
    def make(text, scene=SCENE, **options):
        path = tmp_path / "pilot.py"
        path.write_text(text)
        return build_function(FunctionConfig(file=str(path), **options), scene)

    return make


def test_one_rollout_or_all_give_the_same_driving_actions(controller):
    single, memory = controller(SEEN).act(None, ego(3), prediction(3))
    batched, _ = controller(SEEN, batched=True).act(None, ego(3), prediction(3))
    assert memory is None
    assert isinstance(single, Action)
    np.testing.assert_array_equal(single.acceleration, 8.0 - ego(3).speed)
    np.testing.assert_array_equal(single.yaw_rate, [3.0, 3.0, 3.0])
    np.testing.assert_array_equal(batched.acceleration, single.acceleration)
    np.testing.assert_array_equal(batched.yaw_rate, single.yaw_rate)


def test_an_ego_with_a_lidar_shows_it(controller):
    seen = np.arange(6.0).reshape(3, 2)
    sensed = ObservingEgo(**vars(ego(3)), observation=seen)
    driving, _ = controller("def act(o):\n    return o.ego.observation\n").act(None, sensed, None)
    np.testing.assert_array_equal([driving.acceleration, driving.yaw_rate], seen.T)
    plain, _ = controller("def act(o):\n    return -o\n", scene=None).act(None, sensed, None)
    np.testing.assert_array_equal(plain, -seen)


def test_a_batch_has_vehicles_that_are_not_known_infinitely_far_away_at_rest(controller):
    text = "def act(o):\n    lost = o.others['lost']\n    return lost.x, lost.speed_x\n"
    action, _ = controller(text, batched=True).act(None, ego(2), prediction(2))
    np.testing.assert_array_equal(action.acceleration, [np.inf, np.inf])
    np.testing.assert_array_equal(action.yaw_rate, [0.0, 0.0])


def test_without_a_tracker_there_are_no_others_and_constants_do(controller):
    text = "def drive(o):\n    assert not o.others\n    return -1, 0\n"
    for batched in (False, True):
        action, _ = controller(text, batched=batched, function="drive").act(None, ego(2), None)
        np.testing.assert_array_equal(action.acceleration, [-1.0, -1.0])


def test_other_simulators_give_their_observations(controller):
    seen = np.arange(6.0).reshape(3, 2)
    rows, _ = controller("def act(o):\n    return 2 * o[1]\n", scene=None).act(None, seen, None)
    np.testing.assert_array_equal(rows, [[2.0], [6.0], [10.0]])
    text = "def act(o):\n    return 2 * o[:, 1:]\n"
    batch, _ = controller(text, scene=None, batched=True).act(None, seen, None)
    np.testing.assert_array_equal(batch, rows)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("def drive(o): ...\n", {}, "has no 'act'"),
        ("def drive(o): ...\n", {"function": "drve"}, "did you mean 'drive'"),
        ("import nothing_here\n", {}, "cannot be run: ModuleNotFoundError"),
        ("def act(o):\n", {}, "cannot be run: IndentationError"),
        ("def act(o): ...\n", {}, "act returned None"),
        ("def act(o):\n    return 1.0\n", {}, "must return a pair"),
        ("def act(o):\n    return 1, 2, 3\n", {"batched": True}, "must return a pair"),
        ("def act(o):\n    return {}\n", {}, "act must return numbers"),
        ("def act(o):\n    return 10**400, 0\n", {}, "act must return numbers"),
        ("def act(o):\n    return 10**400, 0\n", {"batched": True}, "must return a pair"),
    ],
)
def test_what_is_wrong_with_a_function_is_told(controller, text, options, message):
    with pytest.raises(UsageError) as caught:
        controller(text, **options).act(None, ego(2), prediction(2))
    assert message in str(caught.value)


def test_a_file_that_is_missing(tmp_path):
    file = tmp_path / "pilot.py"
    with pytest.raises(ValueError, match="should be an existing file"):
        FunctionConfig(file=str(file))
    file.touch()
    config = FunctionConfig(file=str(file))
    file.unlink()
    with pytest.raises(UsageError, match="no such file"):
        build_function(config, None)


@pytest.fixture
def scenario(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*NEW, "--act"]) == 0
    return tmp_path / "cart.yaml"


def test_a_new_scenario_with_a_function_runs_and_belongs_to_its_fingerprint(scenario):
    assert Path("cart.py").read_text() == EXAMPLE.read_text()
    loaded = avrare.load(scenario, ["steps=5"])
    before = fingerprint(loaded.definition)
    result = avrare.estimate(loaded.problem("first"), rollouts=4)
    assert result.diagnostics is not None
    Path("cart.py").write_text("def act(observation):\n    return 0.0\n")
    assert fingerprint(avrare.load(scenario, ["steps=5"]).definition) != before
    assert main(NEW) == 4


def test_what_a_function_raises_is_an_error_of_its_rollout(scenario):
    code = "def act(o):\n    if o[0] < 0.0:\n        raise OSError('no map')\n    return 0.0\n"
    Path("cart.py").write_text(code)
    result = avrare.estimate(avrare.load(scenario, ["steps=1"]).problem("first"), rollouts=40)
    assert 0 < result.errors < 40
    assert "no map" in result.health["errors"]


def test_a_function_that_keeps_something_between_calls_is_named(scenario):
    Path("cart.py").write_text("n = 0\ndef act(o):\n    global n\n    n += 1\n    return 0.1 * n\n")
    with pytest.warns(avrare.HealthWarning, match="not_deterministic"):
        avrare.estimate(avrare.load(scenario, ["steps=5"]).problem("first"), rollouts=4)


def test_safe_mode_runs_no_file(scenario):
    ran = Path("ran")
    Path("cart.py").write_text("open('ran', 'w')\ndef act(o):\n    return 0.0\n")
    with pytest.raises(AvrareError, match="runs installed plugins only"):
        avrare.load(scenario, safe=True)
    assert not ran.exists()


def test_a_simulator_without_actions_needs_no_function(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "scenario", "spill", "--simulator", "tank", "--act"]) == 4
    assert "takes no actions" in capsys.readouterr().err
    assert main(["new", "plugin", "mine", "--kind", "controller", "--act"]) == 4
    assert "--act is for scenarios" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("body", "told"), [("1 / 0", "ZeroDivisionError"), ("exit(0)", "SystemExit: 0")])
def test_what_a_function_raises_is_told_by_validate_and_no_run_passes(scenario, capsys, body, told):
    Path("cart.py").write_text(f"def act(o):\n    return {body}\n")
    assert main(["validate", "--build", str(scenario)]) == 5
    err = capsys.readouterr().err
    assert f"cart.yaml: the controller breaks down in its first steps: {told}" in err
    assert "cart.py:2 in act" in err or told == "SystemExit: 0"
    assert "bug" not in err
    settings = ["--set", "steps=2", "--set", "estimator={plugin: mc, rollouts: 4}"]
    assert main(["run", str(scenario), *settings, "--no-pictures", "--out", "o"]) == 6
    assert f"4 of 4 rollouts ended in an error, more than 1.0% allowed: {told}" in capsys.readouterr().out


def test_a_command_that_is_ended_by_a_part_of_the_stack_has_not_passed(scenario, capsys, monkeypatch):
    monkeypatch.setattr(validation, "load", lambda *_: exit(0))
    assert main(["validate", str(scenario)]) == 5
    assert "a part of the stack ends the program, by exit(0)" in capsys.readouterr().err
