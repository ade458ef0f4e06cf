"""Calls of a simulator of batches, which takes hardly longer for some hundred rows than for one."""

import pytest

import avrare
from plain_systems import Sum


class Counted(Sum):
    """Sum that counts the calls of its steps."""

    calls = 0

    def step(self, state, noise):
        self.calls += 1
        return super().step(state, noise)


def count_calls(estimator, rollouts):
    """Return the calls of an estimate, and its rollouts."""
    system = Counted()
    problem = avrare.Problem(system, avrare.stl("always (x < 28)"), steps=60, chunk=256)
    result = avrare.estimate(problem, estimator, seed=1, rollouts=rollouts)
    assert result.health == {}
    return system.calls, result.rollouts


@pytest.mark.parametrize("estimator", ["is", "auto"])
def test_a_simulator_of_batches_is_called_hardly_more_often_than_by_monte_carlo(estimator):
    calls, rollouts = count_calls(estimator, 15_000)
    assert calls <= 1.3 * count_calls("mc", rollouts)[0]
