"""The wheels work outside the checkout: a new scenario is written, checked, run and reported."""

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLUGINS = ("avrare-example", "avrare-estimators", "avrare-gymnasium")

pytestmark = pytest.mark.slow


def run(*words, cwd):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        list(map(str, words)), cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    out = tmp_path_factory.mktemp("dist")
    options = [
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--no-build-isolation",
        "--wheel-dir",
        out,
    ]
    run(
        sys.executable,
        "-m",
        "pip",
        "wheel",
        *options,
        ROOT,
        *(ROOT / "plugins" / name for name in PLUGINS),
        cwd=out,
    )
    return sorted(out.glob("*.whl"))


@pytest.fixture(scope="module")
def commands(wheels, tmp_path_factory):
    """Return commands of an environment with the wheels, and with what this one has but avrare."""
    home = tmp_path_factory.mktemp("environment")
    venv.create(home, symlinks=True, with_pip=False)
    site = next(home.glob("lib/python*/site-packages"))
    dependencies = home / "dependencies"
    dependencies.mkdir()
    for path in Path(sysconfig.get_path("purelib")).iterdir():
        if "avrare" not in path.name and path.suffix != ".pth":
            (dependencies / path.name).symlink_to(path)
    (site / "dependencies.pth").write_text(f"{dependencies}\n")
    options = ["--quiet", "--disable-pip-version-check", "--no-deps", "--no-index", "--target", site]
    run(sys.executable, "-m", "pip", "install", *options, *wheels, cwd=home)
    return home / "bin" / "python"


def test_a_new_scenario_runs_outside_the_checkout(commands, tmp_path):
    avrare = [commands, "-m", "avrare"]
    where = run(commands, "-c", "import avrare; print(avrare.__file__)", cwd=tmp_path)
    assert str(ROOT) not in where
    run(*avrare, "new", "scenario", "spill", "--simulator", "tank", cwd=tmp_path)
    run(*avrare, "validate", "--build", "spill.yaml", cwd=tmp_path)
    run(*avrare, "run", "spill.yaml", "--out", "seen", "--budget", "rollouts=50", cwd=tmp_path)
    run(
        *avrare,
        "run",
        "spill.yaml",
        "--estimator",
        "ams",
        "--budget",
        "rollouts=3000",
        "--out",
        "split",
        cwd=tmp_path,
    )
    run(*avrare, "report", "seen", cwd=tmp_path)
    assert (tmp_path / "seen" / "report.html").stat().st_size > 10_000
    assert "tank" in run(*avrare, "plugins", cwd=tmp_path)


def test_wheels_hold_code_and_licence_and_no_tests(wheels):
    for wheel in wheels:
        names = zipfile.ZipFile(wheel).namelist()
        assert any(name.endswith("py.typed") for name in names), wheel.name
        assert not any(name.startswith(("tests/", "docs/", "benchmarks/")) for name in names), wheel.name
