"""The code of docs/your-own-simulator.md runs."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "your-own-simulator.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)


HOVER, ESTIMATE = blocks("python")
SCENARIO, _, _, CART = blocks("yaml")
COMMANDS, NEW, _ = blocks("sh")
FEW = ("--set", "estimator.runs=2", "--set", "estimator.particles=20", "--set", "estimator.discard=4")


@pytest.fixture
def folder(tmp_path):
    """Return a folder with the files of the page."""
    (tmp_path / "hover.py").write_text(HOVER)
    (tmp_path / "hover.yaml").write_text(SCENARIO)
    (tmp_path / "cart.yaml").write_text(CART)
    return tmp_path


def run(folder, *words):
    path = os.pathsep.join([str(ROOT), str(folder)])
    variables = {"PYTHONPATH": path, "OMP_NUM_THREADS": "1", "AVRARE_PLUGINS": "avrare,estimators,gymnasium"}
    options = {"env": os.environ | variables, "capture_output": True, "text": True, "check": False}
    return subprocess.run([sys.executable, *words], cwd=folder, **options)


@pytest.mark.slow
def test_in_python(folder):
    program = folder / "program.py"
    program.write_text(ESTIMATE.replace("rollouts=2000", "rollouts=200"))
    done = run(folder, str(program))
    assert done.returncode == 0, done.stderr
    brute, split = done.stdout.splitlines()
    assert brute.startswith("mc ")
    numbers = [float(number) for number in re.findall(r"[\d.e-]+", split.removeprefix("ams"))]
    assert numbers == pytest.approx([6.41e-4, 2.83e-4, 1.45e-3], rel=1e-2)
    assert "6.4e-4, between 2.8e-4 and 1.5e-3" in " ".join(PAGE.split())


@pytest.mark.slow
def test_as_a_scenario(folder):
    validate, estimate = (line.split()[1:] for line in COMMANDS.splitlines())
    assert run(folder, "-m", "avrare", *validate).returncode == 0
    done = run(folder, "-m", "avrare", *estimate, "--json", *FEW)
    assert done.returncode == 0, done.stderr
    (estimate,) = json.loads(done.stdout)["estimates"]
    assert 1e-6 < estimate["probability"] < 5e-2
    assert estimate["errors"] == 0


@pytest.mark.slow
def test_all_worlds_at_once(folder):
    new, estimate = (line.split()[1:] for line in NEW.splitlines())
    assert run(folder, "-m", "avrare", *new).returncode == 0
    done = run(folder, "-m", "avrare", *estimate, "--json")
    (estimate,) = json.loads(done.stdout)["estimates"]
    low, high = estimate["interval"]
    assert low < 3.4e-4 < high


@pytest.mark.slow
def test_as_a_gymnasium_environment(folder):
    done = run(folder, "-m", "avrare", "run", "cart.yaml", "--json")
    assert done.returncode == 0, done.stderr
    (estimate,) = json.loads(done.stdout)["estimates"]
    assert 0.0 < estimate["probability"] < 0.6
    assert estimate["errors"] == 0
