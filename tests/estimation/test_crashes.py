"""A segmentation fault in the probe before an estimate: one message, and the program goes on."""

import re
import subprocess
import sys

import pytest

from avrare.cli.main import main
from avrare.rollout import child_process

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux alone")

PROGRAM = """
import ctypes, sys
import numpy as np
import avrare

class Walk:
    noise_size = 1
    def initial(self, noise): return {"x": np.zeros(len(noise)), "t": np.zeros(len(noise))}
    def step(self, state, noise):
        if state["t"][0] == int(sys.argv[2]): ctypes.string_at(0)
        return {"x": state["x"] + noise[:, 0], "t": state["t"] + 1.0}
    def signals(self, state): return {"x": state["x"]}

if __name__ == "__main__":
    problem = avrare.Problem(Walk(), avrare.stl("always (x < 4)"), steps=20)
    try:
        avrare.estimate(problem, "ams", workers=int(sys.argv[1]), particles=20, discard=4)
    finally:
        print("the program goes on")
"""
SIMULATOR = """
import ctypes

class Simulator:
    noise_size, dt = 1, 0.1

    def reset(self, noise):
        return noise[:, 0].copy()

    def step(self, world, action, noise):
        if (noise[:, 0] > 3.2).any():
            ctypes.string_at(0)
        return world + 0.1 * noise[:, 0]

    def signals(self, world):
        return {"x": world}
"""
CRASHING = """
name: crashing
steps: 20
simulator: {plugin: python, file: simulator.py, class: Simulator}
specifications: {kept: {stl: "always (x < 3)"}}
estimator: {plugin: mc, rollouts: 150}
max_error_rate: 0.1
"""
PILOT = """
import ctypes

def act(o):
    ctypes.string_at(0)
"""
SCENARIO = """
name: drive
steps: 20
simulator:
  plugin: single_track
  road: {lane_centres: [0.0, 3.5], lane_width: 3.5}
  ego: {x: 0.0, y: 0.0, speed: 31.5}
  vehicles: [{name: lead, x: 60.0, y: 0.0, speed: 20.0}]
controller: {plugin: function, file: pilot.py}
specifications:
  gentle: {stl: "always (ego_acceleration > -7.5)"}
estimator: {plugin: mc, rollouts: 100}
thresholds: [{specification: gentle, probability: "< 0.5"}]
"""
HERE = "the system ended its process (SIGSEGV) in the probe before the estimate, at "
IN_A_WORKER = "worker processes ended without an answer (SIGSEGV) in the probe before the estimate"


@pytest.mark.slow
@pytest.mark.parametrize(("workers", "words"), [(1, HERE), (2, IN_A_WORKER)])
def test_python_raises_one_exception(tmp_path, workers, words):
    done = _run_program(tmp_path, workers, 3)
    assert done.returncode == 1
    assert done.stdout == "the program goes on\n"
    assert words in done.stderr
    assert done.stderr.count("Traceback") == 1
    assert ("crash.py:10 in step" in done.stderr) == (workers == 1)


@pytest.mark.slow
def test_a_chunk_that_crashes_this_process_says_where(tmp_path):
    done = _run_program(tmp_path, 1, 15)
    assert done.returncode == -11
    assert 'crash.py", line 10 in step' in done.stderr


@pytest.mark.slow
def test_after_a_crash_the_last_line_goes_on(tmp_path):
    (tmp_path / "simulator.py").write_text(SIMULATOR)
    (tmp_path / "crashing.yaml").write_text(CRASHING)
    command = [sys.executable, "-m", "avrare", "run", "crashing.yaml", "--out", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == -11
    *_, reason, hint = done.stderr.splitlines()
    assert reason == "the process of this run has ended, by a crash or from outside"
    words = re.fullmatch(r"hint: resume with avrare (.*): what crashes is an error there", hint)[1].split()
    done = subprocess.run([*command[:3], *words], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert re.search(r"An error ended 1 of 150 rollouts.*SIGSEGV", done.stdout)


def _run_program(folder, workers, sample):
    path = folder / "crash.py"
    path.write_text(PROGRAM)
    return subprocess.run(
        [sys.executable, str(path), str(workers), str(sample)], capture_output=True, text=True, check=False
    )


@pytest.fixture
def scenario(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(child_process, "_KINDS_RUN_HERE", set())  # or a crash would end the tests
    (tmp_path / "pilot.py").write_text(PILOT)
    (tmp_path / "drive.yaml").write_text(SCENARIO)
    return "drive.yaml"


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize("estimator", ["mc", "auto"])
@pytest.mark.parametrize(
    ("workers", "words"),
    [(1, HERE + "pilot.py:5 in act"), pytest.param(2, IN_A_WORKER, marks=pytest.mark.slow)],
)
def test_a_command_ends_with_its_exit_code(scenario, capfd, command, estimator, workers, words):
    options = ["--estimator", estimator, "--workers", str(workers), "--out", "out"]
    assert main([command, scenario, *options]) == 6
    error = capfd.readouterr().err.splitlines()
    assert error[0] == words
    assert [line.partition(":")[0] for line in error[1:]] == ["hint"]


def test_validate_ends_with_its_exit_code(scenario, capfd):
    assert main(["validate", "--build", scenario]) == 6
    words = "the system ended its process (SIGSEGV) in the first steps of the stack, at pilot.py:5 in act"
    assert capfd.readouterr().err.splitlines()[0] == words
