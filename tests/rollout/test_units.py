"""Scores do not depend on units: each term, and each vehicle's, is measured in its own size."""

import pickle
from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare.logic import FormulaMonitor
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from rollout_requests import fresh

SCENARIOS = Path(__file__).parents[2] / "scenarios"
STEPS = 8
NOISE = NoiseSource(4, 2)


class Pair:
    """Two walks in the units given; ``gap`` holds both for a quantifier."""

    noise_size = 2

    def __init__(self, *units, start=(0.0, 0.0)):
        self.units, self.start = np.array(units), np.array(start)

    def initial(self, noise):
        return np.tile(self.start, (len(noise), 1))

    def step(self, state, noise):
        return state + 0.4 * noise

    def signals(self, state):
        shown = state * self.units
        return {"x": shown[:, 0], "y": shown[:, 1], "far(others)": shown}


class Counting(Pair):
    """Counts the rollouts that it starts."""

    rollouts = 0

    def initial(self, noise):
        type(self).rollouts += len(noise)
        return super().initial(noise)


def scores(problem, rows=60):
    return problem.simulate(NOISE, fresh(rows)).scores


def in_units(system, text, *units, score=None):
    return [
        Problem(system(1.0, u), avrare.stl(text.format(u=u, y=3.0 * u, z=2.5 * u)), STEPS, score)
        for u in units
    ]


def ranks(problem):
    found = scores(problem)
    return np.unique(np.round(found, 9), return_inverse=True)[1].reshape(found.shape)


FORMULAS = [
    "always (x < 3 and y < {y:g})",
    "(always x < 3) and always (y < {y:g})",
    "not (eventually (x > 3 or y >= {y:g}))",
    "always (x < 3 or y < {y:g})",
    "always (once[0:2] (x < 3) and y - {y:g} < 0)",
    "eventually (x < -1 and y < -{y:g})",
    "(x < 1) until (y > {y:g})",
    "always (x < 1 or eventually[0:2] (y < {y:g}))",
]


@pytest.mark.parametrize("text", FORMULAS)
def test_a_smaller_unit_changes_no_order(text):
    equal, small = in_units(Pair, text, 1.0, 1e4)
    np.testing.assert_array_equal(ranks(small), ranks(equal))
    (raw,) = in_units(Pair, text, 1e4, score="robustness")
    assert (ranks(raw) != ranks(equal)).any()


@pytest.mark.parametrize("method", ["ams", "ess"])
@pytest.mark.parametrize("unit", [100.0, 1e4])
def test_an_estimate_keeps_its_bits_in_another_unit(method, unit):
    options = {"particles": 40, "discard": 4} if method == "ams" else {"chains": 20}
    problems = in_units(Pair, "always (x < 2.5 and y < {z:g})", 1.0, unit)
    found = [avrare.estimate(problem, method, seed=3, runs=4, **options) for problem in problems]
    np.testing.assert_array_equal(found[0].run_probabilities, found[1].run_probabilities)
    assert found[0].probability > 0.0
    assert found[0].interval == found[1].interval
    assert found[0].simulated_steps == found[1].simulated_steps
    np.testing.assert_array_equal(found[0].failures.noise, found[1].failures.noise)


@pytest.mark.parametrize("unit", [100.0, 1e4])
def test_a_formula_given_as_score_keeps_the_bits_in_another_unit(unit):
    formula = avrare.stl("always (x < 2.5 and y < 2.5)")
    units = [
        Problem(Pair(1.0, 1.0), formula, STEPS, avrare.stl("always (x < 2.5 and y < 2.5)")),
        Problem(Rescaled(unit), formula, STEPS, avrare.stl(f"always (x < 2.5 and far_y < {2.5 * unit:g})")),
    ]
    found = [avrare.estimate(problem, "ams", seed=3, runs=4, particles=40, discard=4) for problem in units]
    assert found[0].probability > 0.0
    np.testing.assert_array_equal(found[0].run_probabilities, found[1].run_probabilities)
    np.testing.assert_array_equal(found[0].failures.noise, found[1].failures.noise)
    raw = lambda seen, t: np.maximum(seen["x"][:, t], seen["far_y"][:, t] - 2.5 * unit + 2.5)  # noqa: E731
    assert (ranks(units[1].rescore(raw)) != ranks(units[1])).any()


class Rescaled(Pair):
    """Also shows ``y`` in another unit."""

    def __init__(self, unit):
        super().__init__(1.0, 1.0)
        self.unit = unit

    def signals(self, state):
        return {**super().signals(state), "far_y": self.unit * state[:, 1]}


def test_another_score_measures_its_own_terms():
    formula = avrare.stl("always (x < 3 and y < 300)")
    problem = Problem(Pair(1.0, 100.0), formula, STEPS)
    assert len(problem.sizes[0]) == 2
    guided = problem.rescore(avrare.stl("always (x < 3 and y < 300 and x - y < 500)"))
    assert len(guided.sizes[0]) == 3
    np.testing.assert_array_equal(scores(guided.rescore(None)), scores(problem))
    assert guided.rescore(avrare.stl("always (x < 2)")).sizes == (None,)


def test_each_vehicle_is_measured_in_its_own_margin():
    """Take one far vehicle and one near: without noise both lose nothing."""
    formula = "always forall o in others: (far(o) < 3)"
    system = Pair(1.0, 100.0, start=(2.0, 0.02))
    problem = Problem(system, avrare.stl(formula), STEPS)
    tape = np.zeros((3, STEPS + 1, 2))
    tape[1, 1, 0] = 1.25  # the first loses half of its margin of 1
    tape[2, 1, 1] = 0.5 / 100 / 0.4  # so does the second
    found = problem.simulate(NOISE, Request.replay(tape)).scores
    np.testing.assert_allclose(found[:, -1], [-1.0, -0.5, -0.5])


def test_robustness_verdict_and_failures_are_those_of_the_formula():
    formula = avrare.stl("always (x < 1 and y < 100)")
    scaled, raw = (Problem(Pair(1.0, 100.0), formula, STEPS, score) for score in (None, "robustness"))
    one, two = (problem.simulate(NOISE, fresh(60)) for problem in (scaled, raw))
    np.testing.assert_array_equal(one.robustness, two.robustness)
    np.testing.assert_array_equal(one.violated, two.violated)
    assert 0 < one.violated.sum() < 60
    assert (one.scores != two.scores).any()
    np.testing.assert_allclose(two.scores[:, 0], -1.0)


class Drift(Pair):
    """Without noise x passes 3 after some steps, so that its term changes its truth."""

    def step(self, state, noise):
        return super().step(state, noise) + np.array([1.0, 0.0])


def test_margin_ties_nobody_where_a_term_changes_its_truth():
    """Take equal terms, none at 1 throughout: the first steps must not decide the score all the same."""
    small, equal = in_units(Drift, "always (x < 3 or y < {u:g})", 1e4, 1.0, score="margin")
    np.testing.assert_array_equal(ranks(small), ranks(equal))
    nominal = small.simulate(NOISE, Request.replay(np.zeros((1, STEPS + 1, 2))))
    np.testing.assert_allclose(nominal.scores, 0.0, atol=1e-12)
    assert small.gamma(1.0) == 0.0
    found = small.simulate(NOISE, fresh(200))
    assert len(np.unique(found.scores[:, -1])) > 150
    assert 5 < found.violated[:, 0].sum() < 195
    np.testing.assert_array_equal(found.scores[:, -1] >= 1.0, found.violated[:, 0])


class Selecting:
    """Specification whose formula reads signals of its own; where x is at 0, one of them has no value."""

    formula = avrare.stl("always (near < 3 and far < 300)")

    def __init__(self):
        self.monitor = FormulaMonitor(self.formula)

    def sample(self, signals):
        x, y = signals["x"], signals["y"]
        return {"near": x, "far": np.where(x == 0.0, np.nan, 100.0 * y)}

    def start(self, n):
        return self.monitor.start(n)

    def update(self, state, signals):
        return self.monitor.update(state, self.sample(signals))

    def margin(self, state):
        return self.monitor.margin(state)


def test_a_specification_that_selects_its_signals_is_measured_in_theirs():
    """Keep x at 0 without noise: only the rollouts with noise tell the size of the other term."""
    problem = Problem(Pair(1.0, 1.0), Selecting(), STEPS)
    near, far = problem.sizes[0]
    np.testing.assert_allclose(near, 3.0)
    assert 50.0 < far[0] < 500.0


def test_a_term_without_a_margin_is_measured_in_its_spread():
    """Keep y at its limit without noise: its margin there tells no size."""
    small, equal = in_units(Pair, "always (x < 0.5 or y <= 0)", 1e4, 1.0)
    np.testing.assert_array_equal(ranks(small), ranks(equal))
    assert np.abs(scores(small)).max() < 20.0


def test_sizes_are_measured_once_and_travel_with_the_problem():
    Counting.rollouts = 0
    problem = Problem(Counting(1.0, 100.0), avrare.stl("always (x < 3 and y < 300)"), STEPS)
    assert Counting.rollouts == 0
    before = scores(problem, 5)
    assert Counting.rollouts == 6
    copy = pickle.loads(pickle.dumps(problem))
    np.testing.assert_array_equal(scores(copy, 5), before)
    assert Counting.rollouts == 11


def test_a_scenario_sends_its_sizes_to_the_workers():
    scenario = avrare.load(SCENARIOS / "double_integrator.yaml")
    problem = scenario.problem("clear")
    sizes = problem.sizes[0]
    assert sizes is not None
    copy = pickle.loads(pickle.dumps(problem))
    assert copy._sizes is not None
    for one, two in zip(sizes, copy._sizes[0], strict=True):
        np.testing.assert_array_equal(one, two)
