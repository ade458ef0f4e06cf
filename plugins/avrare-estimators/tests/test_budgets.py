"""A budget holds whatever the score: levels that tie must not cost more than was given."""

import pytest
from lattice_problems import lattice_problems

import avrare
from avrare.estimation.plan.budget import Budget


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rollouts", "steps"])
@pytest.mark.parametrize("estimator", ["auto", "is", "ams", "ess"])
def test_no_estimate_exceeds_its_budget(estimator, kind):
    for name, problem in lattice_problems().items():
        amount = 6000 * (problem.steps if kind == "steps" else 1)
        result = avrare.estimate(problem, estimator, seed=1, budget=Budget(kind, amount))
        spent = result.simulated_steps if kind == "steps" else result.rollouts
        assert spent <= 1.1 * amount, name
