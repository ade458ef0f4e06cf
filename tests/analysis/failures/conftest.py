"""A linear scenario that is quick to drive, a drive past a parked car, and systems with known answers."""

from pathlib import Path

import numpy as np
import pytest

import avrare

ROOT = Path(__file__).parents[3]
LINEAR = str(ROOT / "scenarios" / "double_integrator.yaml")
SHORT = ["steps=20", "specifications={near: {stl: 'always (y < 0.2)'}}"]
DRIVE = str(ROOT / "scenarios" / "lane_change_published.yaml")
PARKED = [
    "steps=8",
    "simulator.vehicles=[{name: parked, x: 40.0, y: 1.75}]",
    "specifications={near: {stl: 'always (gap > 1.98)'}}",
]


@pytest.fixture(scope="session")
def load():
    """Load the linear scenario with more overrides."""
    return lambda *overrides: avrare.load(LINEAR, [*SHORT, *overrides])


@pytest.fixture(scope="session")
def linear():
    """Return a system that fails where the point drifts to y = 0.2 within 2 s."""
    return avrare.load(LINEAR, SHORT)


@pytest.fixture
def pushed(linear):
    """Return a failing tape of it: random, with a steady push to the left."""
    tape = np.random.default_rng(1).standard_normal((21, 6))
    tape[:, 3] += 2.0
    assert linear.problem("near").robustness(tape[None])[0] < 0.0
    return tape


@pytest.fixture(scope="session")
def drive_past():
    """Return an ego that drives up to a parked car, seen by a detector."""
    return avrare.load(DRIVE, PARKED)


class Sum:
    """Adds up weighted noise; ``raises`` and ``nan`` say for which totals of channel 0 it breaks down."""

    noise_size = 3

    def __init__(self, weights, raises=np.inf, nan=np.inf):
        self.weights, self.raises, self.nan = np.asarray(weights, dtype=float), raises, nan

    def initial(self, noise):
        return self.step({"t": np.full(len(noise), -1), "x": np.zeros(len(noise))}, noise)

    def step(self, state, noise):
        if (noise[:, 0] > self.raises).any():
            raise ValueError("too much")
        x = state["x"] + np.einsum("nc,nc->n", noise, self.weights[state["t"] + 1])
        return {"t": state["t"] + 1, "x": np.where(noise[:, 0] > self.nan, np.nan, x)}

    def signals(self, state):
        return {"x": state["x"]}


@pytest.fixture(scope="session")
def weighted():
    """Return the problem that a weighted sum of noise, weights (steps + 1, 3), stays below 3."""

    def weighted(weights, formula="always (x < 3)", chunk=25, **breaks):
        system = Sum(weights, **breaks)
        return avrare.Problem(system, avrare.stl(formula), len(weights) - 1, chunk=chunk)

    return weighted
