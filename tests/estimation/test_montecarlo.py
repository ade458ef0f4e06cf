"""Monte Carlo: unbiased, covering, honest about cost and errors, and stopped by what is seen."""

import math
from itertools import pairwise
from statistics import NormalDist

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.base.errors import UsageError
from avrare.estimation.loop.loop import run
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.monte_carlo import AtThreshold, MonteCarlo
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result.intervals import anytime, clopper_pearson, inverse_binomial
from avrare.rollout.executors.serial import SerialExecutor
from avrare.testing import faulty_systems as systems
from avrare.testing.problems import linear


def walk(limit=2.5, system=None, steps=100, **keywords):
    formula = avrare.stl(f"always (x < {limit})")
    return avrare.Problem(system or systems.Walk(), formula, steps=steps, **keywords)


def coin(probability, chunk=4096):
    """Return a problem that fails with the given probability, at once."""
    return linear(-NormalDist().inv_cdf(probability), dim=1).problem(chunk=chunk)


@pytest.mark.parametrize("rollouts", [1, 7, 300])
def test_interval_is_clopper_pearson(rollouts):
    result = avrare.estimate(walk(1.0), rollouts=rollouts, confidence=0.8)
    assert result.interval == clopper_pearson(result.failures.count, rollouts, 0.8)
    assert result.interval_at(0.99) == clopper_pearson(result.failures.count, rollouts, 0.99)


def test_failures_are_kept_up_to_a_limit():
    result = avrare.estimate(walk(0.1), rollouts=2000)
    assert result.failures.count > 1000
    assert len(result.failures.robustness) == len(result.failures.noise) == 100


def test_scores_over_time_are_not_kept():
    """Hold a few numbers for each rollout, whatever the number of steps."""

    states = []

    class Spy(MonteCarlo):
        def tell(self, state, rollouts):
            states.append(super().tell(state, rollouts))
            return states[-1]

    run(walk(), Spy(McConfig(rollouts=500)), SerialExecutor(), Settings())
    (state, _), *_ = states
    assert sum(part.nbytes for part in state.counts.robustness) == 8 * state.counts.trials
    assert not state.counts.verdicts


@pytest.mark.parametrize("how", ["nan", "fault", "raise"])
def test_errors_are_neither_failures_nor_passes(how):
    problem = walk(0.8, system=systems.Fragile(how, beyond=3.0), steps=30)
    result = avrare.estimate(problem, rollouts=1000, seed=4)
    healthy = avrare.estimate(walk(0.8, system=systems.Fragile("never"), steps=30), rollouts=1000, seed=4)
    expected = 1000 * (1 - (1 - 1.35e-3) ** 30)
    assert abs(result.errors - expected) < 4 * math.sqrt(expected)
    assert result.probability == result.failures.count / 1000
    lost = healthy.failures.count - result.failures.count
    assert 0 < lost <= result.errors
    assert result.interval == clopper_pearson(result.failures.count, 1000, 0.95, result.errors)
    assert result.interval[1] > healthy.interval[1]
    assert list(result.health) == ["errors"]
    assert f"{result.errors} of 1000" in result.health["errors"]
    assert ("the planner gave up" in result.health["errors"]) == (how == "raise")
    assert np.isnan(result.robustness).sum() == result.errors
    np.testing.assert_array_equal(problem.robustness(result.failures.noise), result.failures.robustness)


@pytest.mark.parametrize(
    "system", [odd_systems.Broken(), systems.Fragile("raise", beyond=-np.inf, at_start=True)]
)
def test_a_system_that_raises_on_every_row(system):
    result = avrare.estimate(walk(system=system, steps=5), rollouts=40)
    assert (result.probability, result.errors, result.interval) == (0.0, 40, (0.0, 1.0))
    assert "errors" in result.health
    assert math.isnan(result.worst.robustness)
    assert result.to_json()


@pytest.mark.slow
@pytest.mark.parametrize("probability", [0.3, 0.02])
def test_stopping_at_a_relative_error_is_unbiased_and_keeps_its_confidence(probability):
    problem = coin(probability)
    results = [avrare.estimate(problem, seed=seed, relative_error=0.3, confidence=0.9) for seed in range(200)]
    values = np.array([result.probability for result in results])
    error = values.std(ddof=1) / math.sqrt(len(values))
    assert abs(values.mean() - probability) < 4 * error
    spread = math.sqrt(np.mean((values / probability - 1) ** 2))
    assert spread < 0.3 * (1 + 4 / math.sqrt(2 * len(values)))
    assert {result.failures.count for result in results} == {14}
    covered = np.mean([result.interval[0] <= probability <= result.interval[1] for result in results])
    assert covered > 0.9 - 4 * math.sqrt(0.09 / len(results))


def test_a_rule_that_is_never_broken_stops_at_the_maximum_of_rollouts():
    result = avrare.estimate(walk(99.0), relative_error=0.1, rollouts=300)
    assert (result.rollouts, result.probability) == (300, 0.0)
    assert result.interval == clopper_pearson(0, 300, 0.95)
    with pytest.raises(UsageError, match="leave runs at 1"):
        avrare.estimate(walk(), relative_error=0.1, runs=2)


def test_a_stopping_rule_keeps_its_maximum_in_a_run_folder():
    config = McConfig(relative_error=0.1)
    assert config.rollouts == 10**6
    assert McConfig(**config.model_dump()) == config  # a run folder holds all defaults
    assert config.model_dump(exclude_unset=True) == {"relative_error": 0.1}


def test_interval_after_a_planned_stop_is_exact():
    stop, p, confidence = 5, 0.2, 0.9
    covered = 0.0
    for trials in range(stop, 200):
        chance = math.comb(trials - 1, stop - 1) * p**stop * (1 - p) ** (trials - stop)
        low, high = inverse_binomial(stop, trials, confidence)
        covered += chance * (low <= p <= high)
    assert confidence <= covered + 1e-9 < confidence + 0.06
    assert inverse_binomial(3, 3, 0.9)[1] == 1.0


def none(n):
    return np.zeros(n, dtype=bool)


@pytest.mark.parametrize("p", [0.002, 0.02, 0.3])
def test_the_true_probability_is_rarely_excluded_at_any_look(p):
    rule, rng = AtThreshold(p, confidence=0.9), np.random.default_rng(int(1e4 * p))
    wrong = [bool(rule.at(rng.random(6000) < p, none(6000))) for _ in range(500)]
    assert 0 < np.mean(wrong) < 0.1


@pytest.mark.parametrize(("p", "threshold"), [(0.01, 0.02), (0.04, 0.02), (0.0, 1e-3)])
def test_the_decision_is_on_the_right_side(p, threshold):
    rng = np.random.default_rng(7)
    rule = AtThreshold(threshold, confidence=0.95)
    right = 0
    for _ in range(200):
        failed = rng.random(30_000) < p
        stop = rule.at(failed, none(30_000))
        assert stop
        low, high = rule.interval(stop)(int(failed[:stop].sum()), stop, 0.95)
        right += high < threshold if p < threshold else low > threshold
    assert right >= 0.95 * 200 - 4 * np.sqrt(200 * 0.05)


def test_the_stop_is_the_first_interval_that_excludes_the_threshold():
    failed = np.random.default_rng(1).random(4000) < 0.004
    stop = AtThreshold(0.01, 0.95).at(failed, none(4000))
    bounds = [anytime(int(failed[:n].sum()), n, 0.95, around=0.01) for n in range(1, stop + 1)]
    inside = [low <= 0.01 <= high for low, high in bounds]
    assert inside == [True] * (stop - 1) + [False]


def test_without_failures_it_costs_little_more_than_one_planned_look():
    stop = AtThreshold(1e-3, 0.95).at(none(10_000), none(10_000))
    assert 3000 < stop < 5000  # a single planned look needs 2,995


def test_errors_delay_the_decision_as_possible_failures():
    broken = np.arange(6000) % 50 == 0
    assert AtThreshold(1e-2, 0.95).at(none(6000), broken) == 0
    assert AtThreshold(1e-1, 0.95).at(none(6000), broken) > 0
    low, high = anytime(0, 6000, 0.95, errors=120, around=1e-2)
    assert low == 0.0
    assert high > 0.02


def test_the_sequence_of_a_certain_failure():
    low, high = anytime(50, 50, 0.95, around=0.5)
    assert 0.8 < low < 1.0
    assert high == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "options", "failures"),
    [(walk, {"relative_error": 0.2}, 27), (coin, {"threshold": 0.1, "seed": 3}, None)],
)
def test_the_stop_does_not_depend_on_chunks_or_workers(case, options, failures):
    at = 1.5 if case is walk else 0.05
    results = [
        avrare.estimate(case(at, chunk=chunk), workers=workers, **options)
        for chunk, workers in ((64, 1), (64, 2), (1000, 1))
    ]
    kept = [{**r.to_dict(), "seconds": 0, "rollouts": 0, "simulated_steps": 0} for r in results]
    assert kept[0] == kept[1] == kept[2]
    assert results[0].failures.count == (failures or results[0].failures.count)
    assert results[0].diagnostics["used_rollouts"] <= results[0].rollouts


def test_a_threshold_at_the_probability_ends_at_the_maximum_of_rollouts():
    result = avrare.estimate(coin(0.5), threshold=0.5, rollouts=500, seed=1)
    assert result.rollouts == 500
    assert result.interval[0] < 0.5 < result.interval[1]


def test_two_ways_to_stop_are_refused():
    with pytest.raises(UsageError, match="choose one"):
        avrare.estimate(coin(0.5), threshold=0.5, relative_error=0.1)
    with pytest.raises(UsageError, match="leave runs at 1"):
        avrare.estimate(coin(0.5), threshold=0.5, runs=3)


@pytest.mark.parametrize("threshold", [1e-9, 1e-15, 1e-17, 1e-300])
def test_a_tiny_threshold_does_not_give_certainty(threshold):
    """Check a mixture all near 0: its interval is that of a flat likelihood, -log(0.05) / n."""
    low, high = anytime(0, 100_000, 0.95, around=threshold)
    assert low == 0.0
    assert high == pytest.approx(-np.log(0.05) / 100_000, rel=1e-3)
    low, high = anytime(3, 1000, 0.95, around=threshold)
    assert 0.1 * threshold < low < threshold
    assert 0.01 < high < 1.0


@pytest.mark.slow
def test_the_number_of_looks_is_limited():
    looks = []

    class Counting(AtThreshold):
        def at(self, violated, error):
            looks.append(len(violated))
            return super().at(violated, error)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("avrare.estimation.monte_carlo.monte_carlo.AtThreshold", Counting)
        result = avrare.estimate(coin(0.3, chunk=10), threshold=0.303, rollouts=60_000, seed=1)
    assert len(looks) < 120
    assert sum(looks) < 30 * result.rollouts
    assert all(after <= max(before + 64, before * 17 // 16) for before, after in pairwise(looks[:-1]))
