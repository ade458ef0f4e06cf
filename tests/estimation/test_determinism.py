"""The same seed gives the same bits, however the work is cut and whoever does it."""

import json

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.testing import faulty_systems as systems

SETTINGS = {
    "mc": {"rollouts": 300, "runs": 2},
    "ams": {"particles": 30, "discard": 6, "runs": 3},
}
SYSTEMS = [
    systems.Walk(),
    odd_systems.NestedWalk(),
    systems.Fragile("raise", 3.0),
    odd_systems.Odometer(),
]


def estimate(estimator, system=None, chunk=4096, seed=8, score=None, steps=40, **options):
    formula = avrare.stl("always (x < 1.2)")
    problem = avrare.Problem(system or systems.Walk(), formula, steps, score, chunk=chunk)
    return avrare.estimate(problem, estimator, seed=seed, **{**SETTINGS[estimator], **options})


def assert_same(one, other, cost=True):
    first, second = json.loads(one.to_json()), json.loads(other.to_json())
    for entry in (first, second):
        del entry["seconds"]
        if not cost:
            del entry["simulated_steps"]
    assert first == second
    np.testing.assert_array_equal(one.failures.noise, other.failures.noise)
    np.testing.assert_array_equal(one.failures.robustness, other.failures.robustness)
    np.testing.assert_array_equal(one.robustness, other.robustness)


@pytest.mark.parametrize("estimator", SETTINGS)
@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: type(system).__name__)
def test_same_seed_same_bits(estimator, system):
    assert_same(estimate(estimator, system), estimate(estimator, system))


@pytest.mark.parametrize("estimator", SETTINGS)
def test_another_seed_is_another_sample(estimator):
    values = [estimate(estimator, seed=seed).failures.noise.sum() for seed in range(5)]
    assert len(set(values)) == 5


@pytest.mark.parametrize("estimator", SETTINGS)
@pytest.mark.parametrize("chunk", [7, 64])
@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: type(system).__name__)
def test_chunks_do_not_change_results(estimator, chunk, system):
    # The search for a row that raises costs what it costs, and that depends on its company.
    assert_same(
        estimate(estimator, system),
        estimate(estimator, system, chunk=chunk),
        cost=not isinstance(system, systems.Fragile),
    )


@pytest.mark.slow
@pytest.mark.parametrize("estimator", SETTINGS)
def test_workers_do_not_change_results(estimator):
    for system in (odd_systems.NestedWalk(), systems.Fragile("raise", 3.0)):
        for score in (None, "margin", odd_systems.height):
            one, two = (
                estimate(estimator, system, chunk=40, score=score, workers=workers) for workers in (1, 2)
            )
            assert_same(one, two)
            if estimator == "mc":
                break


@pytest.mark.parametrize("estimator", SETTINGS)
def test_runs_are_a_prefix(estimator):
    few, many = (estimate(estimator, runs=runs).run_probabilities for runs in (2, 5))
    assert len(set(many)) > 1
    np.testing.assert_array_equal(few, many[:2])


def test_rollouts_are_a_prefix():
    few, many = (estimate("mc", rollouts=n, runs=1) for n in (100, 250))
    np.testing.assert_array_equal(few.robustness, many.robustness[:100])
