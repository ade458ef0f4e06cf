"""Controls found by slices steer a system without noise through its formula."""

from dataclasses import replace

import numpy as np
import pytest

import avrare
from avrare_linear.control_search import find_controls
from avrare_linear.gaussian import simulate_signals
from avrare_linear.system import LinearSystem

STEPS = 12
GOAL = f"eventually[{STEPS}, {STEPS}] (x > 1 and x < 1.2 and y < 0.1 and y > -0.1)"
GOAL += " and always (x < 0.4 or x > 0.7 or y > 0.3)"


def point():
    dt, eye = 0.3, np.eye(2)
    step, push = np.block([[eye, dt * eye], [0 * eye, eye]]), np.vstack([0 * eye, dt * eye])
    noise = {"process_noise": 0.01 * np.eye(4), "measurement_noise": [[0.1]], "covariance": 0.01 * np.eye(4)}
    options = {"inputs": ("ax", "ay"), "B": push, "costs": (np.eye(4), eye), "outputs": ("seen",)}
    return LinearSystem.of(("x", "y", "vx", "vy"), step, np.zeros(4), C=[[1, 0, 0, 0]], **noise, **options)


def test_the_controls_satisfy_the_formula():
    """Check the formula; by chance such controls are rarer than one in ten thousand."""
    formula, system = avrare.stl(GOAL), point()
    controls = find_controls(system, formula, STEPS, 1.0)
    assert controls.shape == (STEPS, 2)
    steered = replace(system, feedforward=controls, gain=np.zeros_like(system.gain), observer=None)
    signals = simulate_signals(steered, np.zeros((1, STEPS + 1, steered.noise_size)))
    assert formula.satisfied(signals)[0, 0]
    assert formula.robustness(signals)[0, 0] > 0.01
    np.testing.assert_array_equal(controls, find_controls(system, formula, STEPS, 1.0))


def test_impossible_formulas_are_refused():
    with pytest.raises(avrare.UsageError, match="no controls satisfy the formula"):
        find_controls(point(), avrare.stl("always (x > 1)"), STEPS, 1.0, chains=5)
