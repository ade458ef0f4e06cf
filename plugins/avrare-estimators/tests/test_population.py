"""Arrays that splitting keeps of its particles."""

import numpy as np
import pytest

from avrare.protocols import Verdict
from avrare.rollout.request import Carry
from avrare_estimators.ams.population import Population


def carry(x, score):
    """Return a carry whose monitor state is ``score``; the same array as its verdict's score, or another."""
    return Carry({"x": x}, (x,), (Verdict(-score, score > 9.0, score),))


@pytest.mark.parametrize("first_shared", [True, False])
@pytest.mark.parametrize("then_shared", [True, False])
def test_carries_are_stored_correctly_when_leaves_share_an_array(first_shared, then_shared):
    def given(values, shared):
        x = np.asarray(values, dtype=np.float64)
        return carry(x, x if shared else 10.0 * x)

    population = Population.empty(5, 5, 3)
    population.store_carry(2, np.arange(5), given([0, 1, 2, 3, 4], first_shared))
    population.store_carry(2, np.array([3, 1]), given([30, 10], then_shared))
    slots = np.array([1, 2, 3])
    ((step, kept),) = population.branch(slots, np.array([2, 2, 2]))
    assert step == 2
    assert kept.system["x"].tolist() == kept.monitors[0].tolist() == [10, 2, 30]
    old, new = (1 if first_shared else 10), (1 if then_shared else 10)
    assert kept.verdicts[0].score.tolist() == [10 * new, 2 * old, 30 * new]
