"""Wheels of all distributions, tried in fresh environments outside the checkout; megabytes and seconds.

    .venv/bin/python tests/packaging/check_wheels.py python3.11 python3.12 python3.13

Each Python gets the smallest environment in which a stack of one's own runs, core and estimators, and one
with every wheel. ``--first-hour`` also does what a new user does in the first hour (``first_hour.py``).
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PLUGINS = sorted(path.parent for path in ROOT.glob("plugins/*/pyproject.toml"))
SMALLEST = ["avrare", "avrare-estimators"]
PIP = ["-m", "pip", "--quiet", "--disable-pip-version-check"]
ACC = "estimator={plugin: ams, particles: 100, discard: 20, runs: 2}"


def run(*words, cwd):
    """Run a command without the checkout on Python's path; it must succeed. Return its output."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    command = list(map(str, words))
    done = subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)} in {cwd}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def measure(folder):
    """Return the megabytes of all files in a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if not path.is_symlink()) / 1e6


def install(interpreter, home, dist, requirements):
    """Make an environment with these requirements; return its Python, its megabytes and its seconds."""
    run(interpreter, "-m", "venv", home, cwd=dist)
    python = home / "bin" / "python"
    before, began = measure(home), time.monotonic()
    constraint = ["--constraint", ROOT / "constraints.txt"]
    run(python, *PIP, "install", *constraint, "--find-links", dist, *requirements, cwd=dist)
    return python, measure(home) - before, time.monotonic() - began


def try_out(python, folder):
    """Run the commands of a first day in an empty folder; return the seconds of the estimate."""
    folder.mkdir()
    avrare = [python.with_name("avrare")]
    place = run(python, "-c", "import avrare; print(avrare.__file__)", cwd=folder)
    assert str(ROOT) not in place, place
    assert "run" in run(*avrare, "--help", cwd=folder)
    rows = run(*avrare, "plugins", cwd=folder)
    assert "ams" in rows, rows
    run(*avrare, "new", "scenario", "acc", "--python", cwd=folder)
    run(*avrare, "validate", "--build", "acc.yaml", cwd=folder)
    began = time.monotonic()
    assert "no_collision" in run(*avrare, "run", "acc.yaml", "--set", ACC, "--out", "seen", cwd=folder)
    seconds = time.monotonic() - began
    run(*avrare, "report", "seen", cwd=folder)
    assert (folder / "seen" / "report.html").stat().st_size > 10_000
    return seconds


def main():
    """Build the wheels, and print a row for each environment."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("interpreters", nargs="+", metavar="PYTHON")
    parser.add_argument("--first-hour", action="store_true", help="also run first_hour.py with every wheel")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="wheels-") as temporary:
        home = Path(temporary)
        dist = home / "dist"
        dist.mkdir()
        build = ["wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", dist]
        run(sys.executable, *PIP, *build, ROOT, *PLUGINS, cwd=home)
        wheels = sorted(dist.glob("*.whl"))
        assert len(wheels) == len(PLUGINS) + 1, wheels
        print(f"{len(wheels)} wheels, {measure(dist):.1f} MB")
        for number, interpreter in enumerate(args.interpreters):
            version = run(interpreter, "--version", cwd=home).strip()
            for name, requirements in (("smallest", SMALLEST), ("every wheel", wheels)):
                place = home / f"{number}-{name.split()[0]}"
                python, megabytes, seconds = install(interpreter, place, dist, requirements)
                estimate = try_out(python, home / f"{place.name}-day")
                row = f"{version:14} {name:11} {megabytes:4.0f} MB, installed in {seconds:3.0f} s"
                print(f"{row}, estimate of an own stack in {estimate:.0f} s", flush=True)
            if args.first_hour:
                hour = ["--find-links", dist, "avrare[plot]", "avrare-policy[onnx]", "onnx"]
                run(python, *PIP, "install", *hour, cwd=home)
                print(run(python, ROOT / "tests/packaging/first_hour.py", cwd=place), end="", flush=True)


if __name__ == "__main__":
    main()
