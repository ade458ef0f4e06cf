"""The estimator: right on problems with exact answers, whatever its size, its score and its kernel."""

import re
from statistics import NormalDist

import numpy as np
import pytest
from studies.stationarity import rolled_out

import avrare
import odd_systems
from avrare.estimation.loop.loop import run
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result.intervals import clopper_pearson
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.problem import Problem
from avrare.testing import faulty_systems as systems
from avrare.testing.problems import linear, reference_problem, walk
from avrare.testing.repeated_estimates import deviation
from avrare_estimators.common.chains.kernel import Kernel, Move
from avrare_estimators.ess.config import EssConfig
from avrare_estimators.ess.estimator import NestedLevels

SMALL = {"chains": 20, "level_probability": 0.2}
LIPSCHITZ = {"name": "lipschitz", "bound": 1.0}


def estimate(id, **options):
    return avrare.estimate(reference_problem(id).problem(chunk=50_000), "ess", **options)


def off(id, **options):
    """Return standard errors by which the mean of the runs is off."""
    return deviation(estimate(id, **options).run_probabilities, reference_problem(id).probability)


@pytest.mark.slow
def test_mean_over_true_in_a_hundred_dimensions():
    assert abs(off("b_linear_d100_p1e-4", runs=100, chains=30, seed=2)) < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("id", ["a_beta_-2", "b_linear_d100_p1e-4"])
def test_lipschitz_with_a_true_bound(id):
    assert abs(off(id, kernel=LIPSCHITZ, runs=60, **SMALL)) < 4.0


@pytest.mark.parametrize("second_pass", [True, False])
def test_a_false_bound_is_detected(second_pass):
    options = {"runs": 3, "second_pass": second_pass, **SMALL}
    assert "heuristic_kernel" not in estimate("a_beta_-2", kernel=LIPSCHITZ, **options).health
    text = estimate("a_beta_-2", kernel=LIPSCHITZ | {"bound": 0.7}, **options).health["heuristic_kernel"]
    steep, pairs = re.match(r"(\d+) of (\d+) pairs .* by up to (?:1|0\.9\d+) per unit", text).groups()
    assert 0.05 < int(steep) / int(pairs) < 0.9


@pytest.mark.parametrize("kernel", ["lipschitz_growing", "bayesian"])
def test_heuristic_kernels_give_a_warning(kernel):
    assert kernel in estimate("a_beta_-2", kernel=kernel, runs=2, **SMALL).health["heuristic_kernel"]
    assert "heuristic_kernel" not in estimate("a_beta_-2", runs=2, **SMALL).health


@pytest.mark.slow
def test_growing_slope_is_biased():
    """Show why the kernel carries a note."""
    assert off("i_exp_sum_d10_c30.0", kernel="lipschitz_growing", runs=60, **SMALL) > 4.0


def steep(signals, t):
    """Return a score that is infinite long before failure."""
    x = signals["x"][:, t]
    return np.where(x > 0.5, np.inf, x)


@pytest.mark.slow
@pytest.mark.parametrize("score", [odd_systems.backwards, systems.constant, odd_systems.height, steep])
def test_any_score_is_unbiased(score):
    """Count failures at every level, also where a score puts them below it."""
    reference = walk(1.0, 20)
    problem = reference.problem(score=score, chunk=50_000)
    values = avrare.estimate(problem, "ess", runs=200, **SMALL).run_probabilities
    assert abs(deviation(values, reference.probability)) < 4.0


def test_skipped_samples_cost_and_help():
    few, many = (estimate("a_beta_-2.5", runs=200, skip=skip, **SMALL) for skip in (0, 3))
    truth = reference_problem("a_beta_-2.5").probability
    assert abs(deviation(many.run_probabilities, truth)) < 4.0
    assert many.run_probabilities.std() < 0.8 * few.run_probabilities.std()
    assert many.rollouts > 2.5 * few.rollouts


def test_without_levels_it_is_monte_carlo():
    result = avrare.estimate(Problem(systems.Walk(), avrare.stl("always (x < 0.01)"), 3), "ess", runs=3)
    failed = round(float(result.run_probabilities.sum()) * 500)
    assert 0.0 < result.probability < 1.0
    assert result.interval == clopper_pearson(failed, 1500, 0.95)
    assert result.diagnostics["levels"] == [[], [], []]


@pytest.mark.slow
def test_single_run_has_an_interval_and_a_warning():
    truth = reference_problem("c_fourbranch_k7").probability
    results = [estimate("c_fourbranch_k7", runs=1, seed=seed) for seed in range(40)]
    assert all("single_run" in result.health for result in results)
    hits = sum(result.interval[0] <= truth <= result.interval[1] for result in results)
    assert hits >= 26, "too narrow, even for one that leaves out what levels share"
    errors = [result.relative_error for result in results]
    spread = np.std([result.probability for result in results]) / truth
    assert 0.5 * spread < np.median(errors) < 1.5 * spread


def test_breakdowns_near_failure_show_in_the_upper_end():
    """Break rows down beyond the brink: the fresh draws never see it, the chains do."""
    problem = Problem(odd_systems.Doomed(0.9), avrare.stl("always (x < 1)"), 10)
    result = avrare.estimate(problem, "ess", runs=10, **SMALL)
    assert result.errors > 0
    reaching = walk(0.9, 9).probability
    assert result.interval[1] > 0.3 * reaching


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kernel": "lipschitz"}, "'kernel.bound' of estimator 'ess': required, but missing"),
        ({"kernel": {"name": "pcn", "bound": 1.0}}, "unknown option 'kernel.bound'"),
        ({"kernel": "metropolis"}, "'kernel.name' of .* should be one of pcn, shrink, .* found the string"),
        ({"kernel": {"bound": 1.0}}, "'kernel.name' of estimator 'ess': required, but missing"),
        ({"kernel": 3}, "should be a mapping"),
        ({"level_probability": 0.7}, "level_probability"),
        ({"budget": "seconds=3"}, "clock"),
        ({"budget": "rollouts=10"}, "does not pay"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(avrare.UsageError, match=message):
        estimate("a_beta_-2", **options)


class ExactHalfSpace(Kernel):
    """Closed form: an independent draw from total > level, known without a rollout."""

    rollouts = 0.0

    def __init__(self, problem):
        self.problem = problem

    def start(self, tuning, state, level, draw):
        fresh, size = draw.tapes(), self.problem.noise_size
        total = fresh.sum(axis=(1, 2)) / np.sqrt(size)
        uniforms = draw.uniforms(np.arange(len(level)), 0)
        normal, above = NormalDist(), level + 3.0  # score = total - b
        tail = [normal.cdf(-bound) * u for bound, u in zip(above, uniforms, strict=True)]
        wanted = np.array([-normal.inv_cdf(q) for q in tail])
        tape = fresh + ((wanted - total) / np.sqrt(size))[:, None, None]
        done = Move.begin(state, level, draw, tape, ())
        return done.accept(np.ones(len(level), dtype=bool), rolled_out(self.problem, tape)).stay()


def test_a_kernel_in_closed_form_needs_no_rollout():
    reference = linear(3.0, 4)
    problem = reference.problem()
    estimator = NestedLevels(EssConfig(chains=100, runs=100), ExactHalfSpace(problem))
    result = run(problem, estimator, SerialExecutor(), Settings())[0]
    assert abs(deviation(result.run_probabilities, reference.probability)) < 4.0
    assert result.rollouts == 100 * (1000 + 250), "the fresh draws of both passes only"
    ideal = np.sqrt(sum(0.9 / (0.1 * 1000) for _ in range(2)) + 0.3 / (0.7 * 1000))
    assert result.run_probabilities.std() / reference.probability < 2.0 * ideal
