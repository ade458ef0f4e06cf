import math
from pathlib import Path

import numpy as np
import pytest

from avrare.estimation.result.confidence_distributions import Binomial
from avrare.estimation.result.result import Failures, Result, Worst
from avrare.plugin.registry import default_registry

TOY = Path(__file__).parent / "toy"
DRIVE = """\
name: drive
steps: 1
simulator: {plugin: gusts}
controller: {plugin: driver}
specifications:
  in_lane: {stl: "always (offset < 1.6448536269514722)"}     # p = 0.05
estimator: {plugin: mc, rollouts: 2000}
chunk: 1000
"""


@pytest.fixture
def toy(monkeypatch):
    """Return folder of a plugin for wind and drivers, installed in addition to the others."""
    monkeypatch.syspath_prepend(str(TOY))
    monkeypatch.setenv("PYTHONPATH", str(TOY))
    default_registry.cache_clear()
    yield TOY
    default_registry.cache_clear()


@pytest.fixture
def drive(toy, tmp_path, monkeypatch):
    """Return writer of a toy scenario in the current folder; takes lines to add."""
    monkeypatch.chdir(tmp_path)

    def write(more="", text=DRIVE, name="drive.yaml"):
        Path(name).write_text(text + more)
        return name

    return write


@pytest.fixture
def estimate():
    """Return maker of results with a given interval law, as an estimator returns them."""

    def estimate(law=None, *, interval_at=None, **changes):
        law = law or Binomial(5, 1000)
        p = law.failures / law.trials if hasattr(law, "failures") else law.mean
        fields = {
            "specification": "rule", "estimator": "mc", "probability": p,
            "interval_at": interval_at or law.interval_at, "confidence": 0.95,
            "run_probabilities": np.array([p]), "relative_error": 0.1, "rollouts": 1000,
            "simulated_steps": 5000, "errors": 0, "health": {},
            "failures": Failures(np.zeros((0, 2, 1)), np.zeros(0), 5),
            "worst": Worst(np.zeros((2, 1)), math.nan), "robustness": np.zeros(0), "seconds": 2.0,
        }  # fmt: skip
        return Result(**(fields | changes))

    return estimate
