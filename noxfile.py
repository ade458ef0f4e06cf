"""Wheels in a fresh environment of each supported Python, outside the checkout: `nox`, `nox -s wheels-3.13`.

A Python that is not installed is skipped.
"""

from pathlib import Path

import nox

PLUGINS = sorted(str(path.parent) for path in Path("plugins").glob("*/pyproject.toml"))
nox.options.error_on_missing_interpreters = False


@nox.session(python=["3.11", "3.12", "3.13"])
def wheels(session: nox.Session) -> None:
    """Install the wheels of core and plugins, and do what a new user does in the first hour."""
    home = Path(session.create_tmp())
    wheels = home / "dist"
    session.install("hatchling", "editables")
    build = ("--no-deps", "--no-build-isolation", "--quiet", "--wheel-dir", str(wheels))
    session.run("python", "-m", "pip", "wheel", *build, ".", *(f"./{plugin}" for plugin in PLUGINS))
    session.install(
        "--find-links",
        str(wheels),
        "avrare[estimators,plot]",
        "avrare-gymnasium",
        "avrare-policy[onnx]",
        "onnx",
    )
    script = Path("tests/packaging/first_hour.py").resolve()
    session.chdir(home)
    session.run("python", str(script), env={"PYTHONPATH": "", "OMP_NUM_THREADS": "1"})
