"""The pytest plugin, in a pytest of its own."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
BOUND = "thresholds: [{specification: in_lane, probability: '< %s'}]\n"
MARKED = """\
import pytest

@pytest.mark.avrare(scenario="drive.yaml", specification="in_lane", set=["estimator.rollouts=400"])
def test_it_stays_in_lane(avrare_result):
    assert avrare_result.rollouts == 400
    assert avrare_result.interval[1] < 0.1

@pytest.mark.avrare(scenario="drive.yaml", specification="in_lane", budget="rollouts=300")
def test_a_budget(avrare_result):
    assert avrare_result.rollouts == 300

def test_without_a_mark(avrare_result):
    pass

@pytest.mark.avrare(scenario="drive.yaml", specification="in_lane", rollouts=3)
def test_with_a_wrong_mark(avrare_result):
    pass
"""


@pytest.fixture
def run(toy, tmp_path):
    """Run pytest in the temporary folder and return exit code and output."""

    def run(*words, ini="avrare_scenarios = *.yaml\n"):
        (tmp_path / "pytest.ini").write_text(f"[pytest]\n{ini}")
        environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(toy)}
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-p",
            "avrare.cli.pytest_plugin",
            "-p",
            "no:cacheprovider",
            *words,
        ]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        return done.returncode, done.stdout + done.stderr

    return run


@pytest.mark.slow
def test_scenarios_are_tests(drive, run):
    drive(BOUND % 0.1)
    assert run("-q")[0] == 0
    code, output = run("-v", "--strict-markers")
    assert code == 0
    assert "drive.yaml::in_lane < 0.1 PASSED" in output


@pytest.mark.slow
def test_a_verdict_fails_without_a_traceback(drive, run):
    drive(BOUND % 0.02)
    code, output = run("-q")
    assert code == 1
    assert "in_lane < 0.02: fail; the probability is 0.0" in output
    assert "Traceback" not in output
    assert "pytest_plugin.py" not in output


def test_globs_without_files_are_reported(drive, run):
    drive(BOUND % 0.1)
    code, output = run("-q", ini="avrare_scenarios = /abs/*.yaml\n")
    assert code == 4
    assert "Traceback" not in output
    assert "should be a glob relative to" in output
    assert "no file matches 'nope/*.yaml'" in run("-q", ini="avrare_scenarios = nope/*.yaml\n")[1]


@pytest.mark.slow
def test_marked_tests_get_the_estimate(drive, run, tmp_path):
    drive()
    (tmp_path / "test_drive.py").write_text(MARKED)
    code, output = run("-q", "--strict-markers", ini="")
    assert code == 1
    assert "2 passed, 2 errors" in output
    assert "avrare_result needs a mark" in output
    assert "unknown arguments of the mark avrare: rollouts" in output


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "message"),
    [
        ('scenario="nope.yaml", specification="in_lane"', "nope.yaml: no such file"),
        ('scenario="drive.yaml", specification="in_lane", set="stepz=4"', "--set stepz"),
    ],
)
def test_mistakes_in_a_mark_are_reported_without_a_traceback(drive, run, tmp_path, words, message):
    drive()
    test = f"import pytest\n@pytest.mark.avrare({words})\ndef test_it(avrare_result):\n    pass\n"
    (tmp_path / "test_it.py").write_text(test)
    code, output = run("-q", ini="")
    assert code == 1
    assert message in output
    assert "pytest_plugin.py" not in output


def test_importing_the_pytest_plugin_imports_nothing_heavy():
    script = "import pytest, sys; before = set(sys.modules)\nimport avrare.cli.pytest_plugin\n"
    script += "print(*sorted(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    light = {"avrare", "avrare.base", "avrare.base.renderers", "avrare.output", "avrare.output.renderers"}
    assert set(done.stdout.split()) == {*light, "avrare.cli", "avrare.cli.pytest_plugin"}
    tree = ast.parse((ROOT / "avrare" / "cli" / "pytest_plugin.py").read_text())
    top = {name.name for node in tree.body if isinstance(node, ast.Import) for name in node.names}
    assert top == {"pytest"}
