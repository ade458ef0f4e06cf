"""Rollouts that end as soon as their verdict is final."""

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.estimation.loop.loop import run
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.plan import Settings
from avrare.rollout.executors.serial import SerialExecutor
from avrare.testing import faulty_systems as systems


@pytest.mark.parametrize(
    ("text", "least"),
    [
        ("always (x < 1.2)", 0.5),
        ("eventually[2:30] (x > 0.4)", 0.3),
        ("(x > -0.8) until[0:30] (x > 0.6)", 0.3),
        ("always (x > 0.5 -> eventually[0:5] (x < 0.3))", 0.3),
        ("s_next true", 0.0),
        ("always (x < 0.4) iff eventually (x < -0.4)", 0.3),
    ],
)
def test_verdicts_equal_those_of_full_rollouts_at_less_cost(text, least):
    problem = avrare.Problem(systems.Walk(), avrare.stl(text, warn=False), steps=40, chunk=64)
    whole = avrare.estimate(problem, rollouts=400, seed=3)
    short = avrare.estimate(problem, rollouts=400, seed=3, early_stop=True)
    assert short.probability == whole.probability
    assert short.interval == whole.interval
    np.testing.assert_array_equal(short.failures.noise, whole.failures.noise)
    assert least * whole.simulated_steps <= short.simulated_steps <= whole.simulated_steps
    assert short.rollouts == whole.rollouts
    if text != "always (x < 1.2)":
        assert short.simulated_steps < whole.simulated_steps


def test_a_row_continues_until_every_specification_is_decided():
    formulas = {"a": avrare.stl("eventually[0:10] (x > 0.1)"), "b": avrare.stl("always[0:20] (x < 0.7)")}
    system = systems.Counting(systems.Walk())
    estimator = MonteCarlo(McConfig(rollouts=200, early_stop=True))
    results = run(avrare.Problem(system, formulas, steps=40), estimator, SerialExecutor(), Settings())
    checks = odd_systems.rows_of_checks(systems.Walk(), 40) - 40  # of such a rollout there is no replay
    assert results[0].simulated_steps == system.rows - checks
    assert 10 * 200 < results[0].simulated_steps <= 20 * 200
    for name, result in zip(formulas, results, strict=True):
        alone = avrare.Problem(systems.Walk(), formulas[name], steps=40)
        assert avrare.estimate(alone, rollouts=200).probability == result.probability
        assert not result.health


class Blind:
    """A specification without a formula."""

    def __init__(self):
        self.monitor = avrare.stl("eventually (x > 0.5)").monitor()

    def start(self, n):
        return self.monitor.start(n)

    def update(self, state, signals):
        return self.monitor.update(state, signals)


class Reading(Blind):
    """A specification that reads its formula's signals from others."""

    formula = avrare.stl("eventually (y > 0.5)")

    def __init__(self):
        self.monitor = self.formula.monitor()

    def sample(self, signals):
        return {"y": -signals["x"]}

    def update(self, state, signals):
        return super().update(state, self.sample(signals))


def test_specifications_with_and_without_intervals():
    for specification, shorter in ((Reading(), True), (Blind(), False)):
        problem = avrare.Problem(systems.Walk(), specification, steps=30)
        whole, short = (avrare.estimate(problem, rollouts=100, early_stop=stop) for stop in (False, True))
        assert short.probability == whole.probability
        assert (short.simulated_steps < whole.simulated_steps) == shorter
