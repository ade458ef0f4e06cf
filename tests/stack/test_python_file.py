"""Parts ``python``: classes in a file of the scenario, and what is said where they do not fit together."""

import os
import sys

import numpy as np
import pytest

import avrare
from avrare.base.errors import AvrareError, PluginError
from avrare.cli.main import main
from avrare.results.run import Run
from avrare.scenario.fingerprint import fingerprint
from avrare.stack.trial import try_stack

BATCHED = """\
import numpy as np

class Drift:
    dt, noise_size = 0.5, 1
    def __init__(self, scale=1.0):
        self.scale = scale
    def reset(self, noise):
        return {"x": np.zeros(len(noise))}
    def step(self, world, action, noise):
        return {"x": world["x"] + 0.1 * action[:, 0] + self.scale * noise[:, 0]}
    def signals(self, world):
        return world

class Pilot:
    def __init__(self, gain=1.0):
        self.gain = gain
    def act(self, memory, seen, prediction):
        return -self.gain * seen[:, :1], memory
"""
SINGLE = """\
class Drift:
    dt, noise_size = 0.5, 1
    def __init__(self, scale=1.0):
        self.scale = scale
    def reset(self, noise):
        self.x = 0.0
    def step(self, action, noise):
        self.x += 0.1 * action[0] + self.scale * noise[0]
    def signals(self):
        return {"x": self.x}
""" + BATCHED[BATCHED.index("\nclass Pilot") :]
SCENARIO = """\
name: drift
steps: 6
simulator: {plugin: python, file: drift.py, class: Drift}
controller: {plugin: python, file: drift.py, class: Pilot}
specifications: {near: {stl: "always (x < 2)"}}
estimator: {plugin: mc, rollouts: 40}
chunk: 20
"""


@pytest.fixture
def load(tmp_path):
    def write(code, settings=(), text=SCENARIO):
        (tmp_path / "drift.py").write_text(code)
        (tmp_path / "drift.yaml").write_text(text)
        return avrare.load(tmp_path / "drift.yaml", settings)

    return write


@pytest.mark.parametrize("code", [BATCHED, SINGLE])
def test_the_controller_sees_the_signals_and_workers_change_no_bit(load, code):
    stack = load(code).stack
    state = stack.loop.step(stack.loop.initial(np.zeros((3, 1))), np.ones((3, 1)))
    later = stack.loop.step(state, np.zeros((3, 1)))
    np.testing.assert_allclose(stack.loop.signals(later)["x"], 0.9)
    problem = load(code).problem("near")
    one, two = (avrare.estimate(problem, "mc", rollouts=40, workers=workers) for workers in (1, 2))
    assert 0 < one.probability < 1
    np.testing.assert_array_equal(one.robustness, two.robustness)


def test_options_are_arguments_of_the_class_and_the_code_belongs_to_the_fingerprint(load):
    options = ["simulator.options.scale=3", "controller.options.gain=2.5"]
    loop = load(BATCHED, options).stack.loop
    assert (loop.simulator.part.scale, loop.controller.part.gain) == (3, 2.5)
    before = fingerprint(load(BATCHED).definition)
    assert fingerprint(load(BATCHED, options).definition) != before
    assert fingerprint(load(BATCHED.replace("0.1 *", "0.2 *")).definition) != before


def test_parts_of_one_file_share_its_classes(load):
    loop = load(BATCHED).stack.loop
    assert type(loop.simulator.part).__module__ == type(loop.controller.part).__module__


@pytest.mark.parametrize(
    ("code", "settings", "message"),
    [
        (BATCHED, ["simulator.class=Drif"], "did you mean 'Drift'"),
        (BATCHED, ["simulator.options.scal=1"], "argument 'scal'\nhint: `options` of Drift: scale"),
        (BATCHED.replace("def signals", "def signal"), [], "Drift has no signals"),
        (BATCHED.replace("def act", "def acts"), [], "Pilot has no act"),
        (SINGLE.replace("dt, noise_size = 0.5, 1", "noise_size = 1"), [], "Drift has no dt"),
        (BATCHED.replace("import numpy", "import nothing_here"), [], "cannot be run: ModuleNotFoundError"),
    ],
)
def test_mistakes_of_the_file_are_told(load, code, settings, message):
    with pytest.raises(AvrareError) as caught:
        _ = load(code, settings).stack
    assert message in "\n".join(caught.value.lines())


@pytest.mark.parametrize(
    ("old", "new", "message", "hint"),
    [
        ("seen[:, :1]", "seen.speed", "the controller breaks down", "the signals x: give the simulator's"),
        ("action[:, 0]", "action.force", "the stack breaks down", "the controller's action, an array (1, 1)"),
    ],
)
def test_parts_that_do_not_fit_together_are_told_what_they_get(load, old, new, message, hint):
    scenario = load(BATCHED.replace(old, new))
    with pytest.raises(PluginError, match=message) as caught:
        try_stack(scenario.definition, scenario.stack)
    assert hint in caught.value.hint


def test_a_simulator_without_its_controller_asks_for_one(load):
    scenario = load(BATCHED, text=SCENARIO.replace("controller:", "# "))
    with pytest.raises(PluginError) as caught:
        try_stack(scenario.definition, scenario.stack)
    assert "add a `controller:`" in caught.value.hint


def test_safe_mode_runs_no_file(load, tmp_path, monkeypatch):
    load(BATCHED)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path not in ("", os.getcwd())])
    with pytest.raises(AvrareError) as caught:
        avrare.load(tmp_path / "drift.yaml", safe=True)
    assert str(caught.value).count("safe mode runs installed plugins only, and no Python files") == 2


@pytest.mark.slow
def test_a_rollout_that_crashes_is_replayed_to_the_line_of_the_file(load, tmp_path, monkeypatch, capsys):
    """Count it as an error, in a worker process, and keep its tape."""
    monkeypatch.chdir(tmp_path)
    crash = "\n        if (noise[:, 0] > 2.5).any(): import ctypes; ctypes.string_at(0)\n        return {"
    code = BATCHED.replace("\n        return {", crash).replace(crash, "\n        return {", 1)
    load(code)
    settings = ["--set", "rollout_timeout=60", "--set", "max_error_rate=0.2"]
    assert main(["run", "drift.yaml", *settings, "--out", "run", "--quiet"]) == 0
    result = Run.read("run")["near"]
    assert 0 < result.errors == len(result.error_tapes)
    assert f"40 rollouts, {result.errors} errors" in repr(result)
    assert max(tape[1:].max() for tape in result.error_tapes) > 2.5
    capsys.readouterr()
    assert main(["replay", "--run", "run", "--error", "0"]) == 6
    error = capsys.readouterr().err
    assert error.startswith("the system ended its process (SIGSEGV) in the replay, at drift.py:10 in step\n")
    assert main(["replay", "--run", "run", "--error", "9"]) == 4


@pytest.mark.slow
def test_a_replay_that_hangs_ends_at_the_line_of_the_file(load, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    error = "\n        if (noise[:, 0] > 2.5).any(): raise RuntimeError\n        return {"
    code = BATCHED.replace("\n        return {", error).replace(error, "\n        return {", 1)
    load(code)
    settings = ["--set", "rollout_timeout=2", "--set", "max_error_rate=0.2"]
    assert main(["run", "drift.yaml", *settings, "--out", "run", "--quiet"]) == 0
    load(code.replace("raise RuntimeError", "import time; time.sleep(600)"))
    capsys.readouterr()
    assert main(["replay", "--run", "run", "--error", "0"]) == 6
    assert "the rollout takes more than 2 s: it hangs at drift.py:10 in step\n" in capsys.readouterr().err


def test_a_file_that_is_missing_has_its_place_in_the_scenario(load):
    with pytest.raises(AvrareError, match=r"drift\.yaml:3:35: simulator\.file: should be an existing file"):
        load(BATCHED, text=SCENARIO.replace("file: drift.py", "file: nowhere.py", 1))
