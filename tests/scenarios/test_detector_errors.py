"""The study of detector errors: what the loop perceives is scaled, on the same tapes."""

import sys
from pathlib import Path

import numpy as np
import pytest

from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

from detector_errors import scaled_problem  # noqa: E402

SETTINGS = ["controller.search=follow"]


def first_observation(**factors):
    """Return errors (N, V, 2) and detections of the first step, before the controller knows any error."""
    scenario = LoadedScenario(load(ROOT / "scenarios" / "lane_change.yaml", SETTINGS))
    problem = scaled_problem(scenario, **factors)
    system = problem.system
    noise = np.random.default_rng(5).standard_normal((2, 12, problem.noise_size))
    state = system.step(system.initial(noise[0]), noise[1])
    seen, others = state.observation, state.world.others
    return np.stack([seen.x - others.x, seen.y - others.y], axis=-1), seen.detected


@pytest.fixture(scope="module")
def plain():
    return first_observation()


def test_errors_are_scaled(plain):
    errors, detected = first_observation(errors=3.0)
    assert np.array_equal(detected, plain[1])
    assert np.abs(plain[0][detected]).max() > 0.05
    np.testing.assert_allclose(errors[detected], 3.0 * plain[0][detected], rtol=1e-6, atol=1e-9)


def test_misses_are_scaled(plain):
    never, fewer = (first_observation(misses=factor)[1] for factor in (1e9, 1e-9))
    assert not never.any()
    assert fewer.all()
    assert 0 < plain[1].sum() < plain[1].size
