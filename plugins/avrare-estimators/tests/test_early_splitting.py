"""Splitting whose rollouts end with their verdict: the same estimate, for fewer steps."""

import numpy as np
import pytest

import avrare
from avrare.testing.faulty_systems import Counting, Walk
from avrare.testing.repeated_estimates import deviation
from avrare.testing.walk_problems import walk

OPTIONS = {"particles": 60, "discard": 6, "runs": 3, "seed": 5}


@pytest.mark.parametrize("memory", [None, 0.1])
@pytest.mark.parametrize("chunk", [None, 7])
@pytest.mark.filterwarnings("ignore::avrare.base.errors.HealthWarning")
def test_same_bits_for_fewer_steps(chunk, memory):
    def problem(system):
        return avrare.Problem(system, avrare.stl("always (x < 1.4)"), steps=30, chunk=chunk)

    counting = Counting(Walk())
    whole = avrare.estimate(problem(Walk()), "ams", memory=memory, **OPTIONS)
    short = avrare.estimate(problem(counting), "ams", memory=memory, early_stop=True, **OPTIONS)
    names = ("probability", "interval", "relative_error", "rollouts", "health", "blind_bound")
    for name in names:
        assert getattr(short, name) == getattr(whole, name), name
    assert short.diagnostics["levels"] == whole.diagnostics["levels"]
    np.testing.assert_array_equal(short.failures.noise, whole.failures.noise)
    saved = short.diagnostics["saved_steps"]
    assert saved > 0.03 * whole.simulated_steps
    if memory is None:  # else more carries, which are larger, are simulated again
        assert short.simulated_steps + saved == whole.simulated_steps <= counting.rows + saved


@pytest.mark.filterwarnings("ignore::avrare.base.errors.HealthWarning")
def test_unbiased_where_the_window_ends_before_the_rollout():
    reference = walk(1.2, 20)
    problem = avrare.Problem(Walk(), avrare.stl("always[0:20] (x < 1.2)"), steps=40)
    options = {"particles": 50, "discard": 10, "runs": 150, "early_stop": True, "grow": False}
    result = avrare.estimate(problem, "ams", seed=2, **options)
    assert abs(deviation(result.run_probabilities, reference.probability)) < 4.0
    assert result.diagnostics["saved_steps"] > 0.9 * result.simulated_steps


def test_the_published_variant_has_no_verdicts():
    with pytest.raises(avrare.UsageError, match="published"):
        avrare.estimate(walk(1.0, 5).problem(), "ams", variant="published", early_stop=True)
