"""Programs as simulators and controllers: the same rollouts as in Python, whatever happens to the program."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

import avrare
from avrare.base.errors import UsageError
from avrare.scenario.safe_mode import safe_mode
from avrare.stack.closed_loop import ClosedLoop
from avrare.stack.python_file import TEMPLATES, find_member
from avrare.testing.conformance import Subject, checks_of
from avrare_process.config import EXAMPLE, ProcessConfig
from avrare_process.parts import build_controller, build_simulator
from avrare_process.process import Process

RULE = avrare.stl("always (gap > 5)")
FAULTS = """
import os, time
class Road(Road):
    def step(self, action, noise):
        super().step(action, noise)
        if self.time > 0.95 and self.error > {limit}:
            {fault}
"""


def config(*words, **options):
    return ProcessConfig(command=tuple(map(str, words or (sys.executable, EXAMPLE))), **options)


def program(path, head="", **replaced):
    """Write the example with further classes and other words; return the command."""
    code = EXAMPLE.read_text()
    for old, new in replaced.items():
        assert old in code
        code = code.replace(old, new)
    path.write_text(code.replace("def serve", f"{head}\n\ndef serve", 1))
    return sys.executable, path


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        pytest.skip("no C++ compiler")
    path = tmp_path_factory.mktemp("cpp") / "acc"
    flags = "-std=c++17", "-O2", "-ffp-contract=off"
    subprocess.run([compiler, *flags, "-o", path, EXAMPLE.with_suffix(".cpp")], check=True)
    return path


def loop(simulator, controller=None):
    return ClosedLoop(build_simulator(simulator), controller=build_controller(controller or simulator))


def estimate(system, estimator="mc", steps=100, workers=1, rollouts=60, **options):
    if estimator == "ams":
        options = {"particles": 20, "discard": 2, "runs": 2, **options}
    else:
        options["rollouts"] = rollouts
    problem = avrare.Problem(system, RULE, steps=steps, chunk=30)
    return avrare.estimate(problem, estimator, seed=1, workers=workers, **options)


@pytest.fixture(scope="session")
def reference():
    files = {"Simulator": "stack.py.txt", "Controller": "stack_controller.py.txt"}
    parts = [find_member(str(TEMPLATES / file), name, "")() for name, file in files.items()]
    return {name: estimate(ClosedLoop(parts[0], controller=parts[1]), name) for name in ("mc", "ams")}


def assert_same(result, wanted):
    assert result.probability == wanted.probability
    np.testing.assert_array_equal(result.robustness, wanted.robustness)


@pytest.mark.parametrize("connect", ["stdio", "socket"])
def test_a_python_program_gives_the_bits_of_a_python_file(reference, connect):
    assert 0 < reference["mc"].probability < 1
    assert_same(estimate(loop(config(connect=connect)), workers=2), reference["mc"])


def test_a_c_plus_plus_program_gives_the_bits_of_a_python_file(reference, built):
    for name in ("mc", "ams"):
        assert_same(estimate(loop(config(built)), name), reference[name])


@pytest.mark.parametrize(("copy", "workers"), [("True", 1), ("True", 2), ("False", 1)])
def test_branches_by_copies_and_by_replay_agree(reference, tmp_path, copy, workers):
    command = program(tmp_path / "acc.py", **{'"copy": True': f'"copy": {copy}'})
    assert_same(estimate(loop(config(*command)), "ams", workers=workers), reference["ams"])


def test_a_controller_with_memory_keeps_its_own_for_each_rollout(reference, tmp_path):
    command = program(tmp_path / "acc.py", **{'"memory": False': '"memory": True'})
    for name in ("mc", "ams"):
        assert_same(estimate(loop(config(*command)), name), reference[name])


@pytest.mark.parametrize("copy", ["True", "False"])
def test_a_program_that_dies_is_started_again_and_replayed(reference, tmp_path, copy):
    mark = tmp_path / "died"
    fault = f"(open({str(mark)!r}, 'x'), os._exit(3)) if not os.path.exists({str(mark)!r}) else None"
    replaced = {'"copy": True': f'"copy": {copy}'}
    command = program(tmp_path / "acc.py", FAULTS.format(limit=1.0, fault=fault), **replaced)
    assert_same(estimate(loop(config(*command)), "ams"), reference["ams"])
    assert mark.exists()


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ("sys.exit('the radar is broken')", "ended in step: the radar is broken"),
        ("time.sleep(60)", "did not answer to step within 1 s"),
        ("self.gap = float('nan')", "gap"),
    ],
)
def test_a_rollout_that_breaks_the_program_is_an_error_and_the_others_keep_their_bits(tmp_path, fault, text):
    command = program(tmp_path / "acc.py", FAULTS.format(limit=4.0, fault=fault))
    system = loop(config(*command, timeout=1.0), config())
    result = estimate(system, steps=10, rollouts=30)
    wanted = estimate(loop(config()), steps=10, rollouts=30)
    assert 0 < result.errors < 10
    good = np.isfinite(result.robustness)
    assert good.sum() == 30 - result.errors
    np.testing.assert_array_equal(result.robustness[good], wanted.robustness[good])
    assert text in str(result.health)


@pytest.mark.parametrize(
    ("replaced", "message"),
    [
        ({'"dt": 0.1': '"dt": -1.0'}, "answered wrongly to hello: dt"),
        ({'"outputs": ["gap", "speed"],': ""}, "answered wrongly to hello: outputs"),
        ({"def serve(reader, writer):": "def serve(reader, writer):\n    print('ready')"}, "not a JSON"),
        ({"worlds = {}": "sys.exit('no licence')"}, "ended in hello: no licence"),
    ],
)
def test_mistakes_of_the_program_are_told(tmp_path, replaced, message):
    command = program(tmp_path / "acc.py", **replaced)
    with pytest.raises(UsageError, match=message):
        build_simulator(config(*command))


def test_missing_numbers_are_told(tmp_path):
    command = program(tmp_path / "acc.py", **{"return [self.gap, self.speed,": "return ["})
    with pytest.raises(UsageError, match=r"reset with outputs of shape \(2, 3\)"):
        build_simulator(config(*command)).reset(np.zeros((2, 1)))


def test_a_missing_program_is_told():
    with pytest.raises(UsageError, match="cannot be started"):
        build_simulator(config("./nothing"))
    with pytest.raises(UsageError, match="did not connect"):
        build_simulator(config(sys.executable, "-c", "", connect="socket"))


def test_safe_mode_runs_no_program():
    with safe_mode(), pytest.raises(ValidationError, match="safe mode"):
        config()


def test_the_program_belongs_to_the_fingerprint():
    assert config().used_files() == {"command.0": Path(sys.executable), "command.1": EXAMPLE}


def test_the_program_ends_with_its_simulator():
    simulator = build_simulator(config())
    end = simulator.client._process.end
    assert end.alive
    del simulator
    assert not end.alive


@pytest.mark.parametrize("kind", ["simulator", "controller"])
def test_conformance(kind):
    for check in checks_of(kind):
        outcome = check.run(Subject.find_installed(kind, "process"))
        assert outcome.status != "failed", f"{check.name}: {outcome.reason}"


def test_the_example_answers_as_the_page_says():
    page = (Path(__file__).parents[3] / "docs" / "your-own-simulator.md").read_text()
    rows = re.findall(r"^\| `(\{.*?\})` \| `(\{.*\})` \|$", page, re.M)
    process = Process(config())
    answers = [(process.ask(json.loads(message)), answer) for message, answer in rows]
    assert len(answers) == 4
    assert all(answer == json.loads(wanted) for answer, wanted in answers if "..." not in wanted)
