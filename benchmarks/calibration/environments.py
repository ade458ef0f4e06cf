"""Environments of the tools, each of its own: python -m benchmarks.calibration.environments [NAME ...]."""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).parents[2] / ".venv-calibration"
PACKAGES = {
    "openturns": ["openturns==1.27.post1"],
    "uqpy": ["UQpy==4.2.1"],
    "pytams": ["pytams==1.0.0"],
    "sentil": ["sentil==0.3.1"],
    "verifai": ["verifai==2.2.0"],
}
"""Distributions of each environment; avrare and the textbook run in that of the benchmark itself."""


def interpreter(name: str) -> Path | None:
    """Return the Python of an environment, None where it is not made."""
    if name not in PACKAGES:
        return Path(sys.executable)
    python = ROOT / name / "bin" / "python"
    return python if (ROOT / name / "complete").exists() else None


def make(name: str) -> None:
    """Make an environment, unless it is there."""
    if interpreter(name):
        return
    venv.create(ROOT / name, with_pip=True, clear=True)
    python = str(ROOT / name / "bin" / "python")
    subprocess.run([python, "-m", "pip", "install", "--quiet", "numpy", *PACKAGES[name]], check=True)
    (ROOT / name / "complete").touch()


def main(names: list[str]) -> None:
    """Make the environments of these names, or all; one that fails leaves the others."""
    for name in names or PACKAGES:
        try:
            make(name)
            print(f"{name}: {interpreter(name)}", flush=True)
        except subprocess.CalledProcessError:
            print(f"{name}: could not be installed; its tools are left out", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
