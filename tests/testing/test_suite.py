"""The conformance suite on estimators that lie: each lie is found out by the test that is meant for it."""

import math
import subprocess
import sys
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from scipy import stats

from avrare.testing.estimators import EstimatorConformance
from avrare.testing.problems import count_down, walk
from avrare.testing.repeated_estimates import Study, coverage_at_most, deviation, standard_error


class Honest(EstimatorConformance):
    options = MappingProxyType({"rollouts": 200})
    seeds = Study(count_down(5, 9, "1/5"), 100)


def liar(lie, **defaults):
    """Return Monte Carlo with a lie about its result, and with other arguments than it was given."""

    class Suite(Honest):
        def estimate(self, problem, **keywords):
            return lie(super().estimate(problem, **{**keywords, **defaults}))

    return Suite()


def shifted(result, by=0.5):
    runs, probability = result.run_probabilities * by, result.probability * by
    return replace(result, run_probabilities=runs, probability=probability)


def narrow(result):
    ends = (result.probability * 0.9, min(1.0, result.probability * 1.1))
    return replace(result, interval_at=lambda _: ends)


def wide(result):
    return replace(result, interval_at=lambda confidence: (0.0, 1.0))


def other_tapes(result):
    failures = result.failures
    return replace(result, failures=replace(failures, noise=-failures.noise))


def infinite(result):
    class Raw(type(result)):
        def to_json(self):
            return super().to_json().replace("null", "NaN")

    return Raw(**{name: getattr(result, name) for name in result.__dataclass_fields__})


def sorted_runs(result):
    return replace(result, run_probabilities=np.sort(result.run_probabilities))


def errors_dropped(result):
    """Return the upper end without the errors: as if they could not have failed."""
    high = result.probability * 3.0
    return replace(result, interval_at=lambda confidence: (0.0, high))


def lies():
    def same(result):
        return result

    study = Study(walk(1.0, 20), 200)
    return [
        ("test_unbiased", liar(shifted), (study,), "standard errors"),
        ("test_unbiased", liar(lambda result: shifted(result, 2.0)), (study,), "standard errors"),
        ("test_unbiased", liar(same, rollouts=10), (study,), "too weak"),
        ("test_unbiased", liar(same, runs=3), (study,), "every run counts"),
        ("test_unbiased_with_errors", liar(lambda r: shifted(r, 1.3)), (), "standard errors"),
        ("test_interval_covers", liar(narrow), (), "intervals cover"),
        ("test_interval_covers", liar(wide), (), "says too little"),
        ("test_interval_widens_with_confidence", liar(same, confidence=0.5), (), "not have the confidence"),
        ("test_other_seeds_differ", liar(same, seed=1), (), "seeds share"),
        ("test_runs_are_a_prefix", liar(sorted_runs), (), "not equal"),
        ("test_cost_is_honest", liar(lambda r: replace(r, simulated_steps=9)), (), "stepped"),
        ("test_cost_is_honest", liar(lambda r: replace(r, rollouts=r.rollouts + 1)), (), "starts and"),
        ("test_budget_is_kept", liar(same, budget="rollouts=5010"), ("rollouts",), "of 5000 rollouts"),
        ("test_budget_is_kept", liar(same, budget="steps=20000"), ("steps",), "of 100000 steps"),
        ("test_result_is_consistent", liar(lambda r: replace(r, probability=0.5)), (), "mean of the runs"),
        ("test_failures_replay", liar(other_tapes), (), "does not fail"),
        ("test_json_has_no_nan", liar(infinite), (), "NaN is not JSON"),
        ("test_impossible", liar(wide), (), "no upper bound"),
        ("test_certain", liar(shifted), (), r"\(0.5, 1.0\)"),
        ("test_errors_are_counted", liar(lambda r: replace(r, errors=0)), (), "errors are counted"),
        ("test_errors_are_counted", liar(errors_dropped), (), "does not count errors"),
    ]  # fmt: skip


@pytest.mark.parametrize(("test", "suite", "arguments", "message"), lies())
def test_false_results_are_detected(test, suite, arguments, message):
    with pytest.raises(AssertionError, match=message):
        getattr(suite, test)(*arguments)


def test_seeds_that_do_not_repeat_are_detected():
    class Restless(Honest):
        calls = 0

        def estimate(self, problem, **keywords):
            Restless.calls += 1
            return super().estimate(problem, **{**keywords, "seed": Restless.calls})

    with pytest.raises(AssertionError, match="chunk=4096, workers=1"):
        Restless().test_same_seed_same_bits()


@pytest.mark.parametrize("test", ["test_unknown_option_is_refused", "test_budget_too_small_is_refused"])
def test_estimators_that_accept_any_option_are_detected(test):
    class Lenient(Honest):
        def estimate(self, problem, **keywords):
            return super().estimate(problem)

    with pytest.raises(pytest.fail.Exception, match="DID NOT RAISE"):
        getattr(Lenient(), test)()


def test_unsupported_must_name_a_test():
    with pytest.raises(TypeError, match="test_unbaised"):

        class Misspelt(EstimatorConformance):
            unsupported = MappingProxyType({"test_unbaised": "never mind"})


def test_statistics_by_hand():
    values = np.array([1.0, 2.0, 3.0])
    assert standard_error(values) == pytest.approx(1.0 / math.sqrt(3.0))
    assert deviation(values, 1.0) == pytest.approx(math.sqrt(3.0))
    assert deviation(values[:1].repeat(3), 1.0) == 0.0
    assert deviation(values[:1].repeat(3), 2.0) == -math.inf


@pytest.mark.parametrize(
    ("hits", "trials", "p"), [(0, 5, 0.9), (170, 200, 0.9), (199, 200, 0.95), (200, 200, 0.5)]
)
def test_the_slack_of_coverage_is_binomial(hits, trials, p):
    assert coverage_at_most(hits, trials, p) == pytest.approx(stats.binom.cdf(hits, trials, p), rel=1e-9)


def test_the_problems_need_no_pytest():
    code = "import sys, avrare.testing.problems, avrare.testing.faulty_systems; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "avrare.testing.problems" in done.stdout.split()
    assert not {"pytest", "scipy", "torch", "matplotlib"} & set(done.stdout.split())
