"""The example plugin as its readers get it: built as a wheel, installed by itself, found, and run."""

import json
import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

import avrare

EXAMPLE = Path(__file__).parents[3] / "plugins" / "avrare-example"
ROOT = Path(__file__).parents[3]


def run(*command, **environment):
    base = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "AVRARE_PLUGINS")}
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, check=False, timeout=120,
        env={**base, "OMP_NUM_THREADS": "1", **environment},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Return Python of a new environment with nothing but the wheel, and where its dependencies are."""
    folder = tmp_path_factory.mktemp("example")
    offline = ("--quiet", "--no-deps", "--no-index", "--disable-pip-version-check")
    build = ("-m", "pip", "wheel", *offline, "--no-build-isolation", "--wheel-dir", folder, EXAMPLE)
    run(sys.executable, *build)
    (wheel,) = folder.glob("*.whl")
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv")
    python = folder / "venv" / "bin" / "python"
    target = run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    run(sys.executable, "-m", "pip", "install", *offline, "--target", target, wheel)
    # On the path, but no site folder: what is installed there in editable mode is not seen.
    path = os.pathsep.join([sysconfig.get_path("purelib"), str(ROOT)])
    return python, {"PYTHONPATH": path, "AVRARE_PLUGINS": "example"}


@pytest.mark.slow
def test_the_scenario_of_its_readme_runs(installed, tmp_path):
    python, environment = installed
    (text,) = re.findall(r"```yaml\n(.*?)```", (EXAMPLE / "README.md").read_text(), flags=re.DOTALL)
    (tmp_path / "tank.yaml").write_text(text)
    result = json.loads(run(python, "-m", "avrare", "run", tmp_path / "tank.yaml", "--json", **environment))
    dry, low = result["estimates"]
    assert result["versions"]["avrare-example"] == avrare.__version__
    assert 0.0 < dry["probability"] < low["probability"] < 0.2


def test_the_example_passes_the_checks(installed):
    python, environment = installed
    lines = run(python, "-m", "avrare", "plugins", "--check", "avrare-example", **environment).splitlines()
    assert lines[-1] == "26 passed, 0 failed, 0 skipped"
