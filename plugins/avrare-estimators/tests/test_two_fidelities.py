"""``mfmc``: a cheap twin saves rollouts, and the estimate stays that of the stack itself."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest

import avrare
from avrare.analysis.causes.failure_sample import FailureSample
from avrare.base.errors import UsageError
from avrare.estimation.combine.ensemble import combine
from avrare.estimation.result import intervals
from avrare.rollout.twin import measure_cost
from avrare.testing.faulty_systems import Killed, Mortal
from avrare.testing.repeated_estimates import coverage_at_most, deviation
from avrare_estimators.two_fidelities.two_phase import plan_design, scale_rates
from estimates import estimate_through_kills, plain

pytestmark = pytest.mark.filterwarnings("ignore::avrare.base.errors.HealthWarning")


class Turned:
    """System that fails far along a direction of its two normal numbers; ``cosine`` 1 is the stack."""

    noise_size = 2

    def __init__(self, cosine=1.0, breaks=np.inf):
        self.cosine, self.breaks = cosine, breaks

    def initial(self, noise):
        return {"u": noise}

    def step(self, state, noise):
        return {"u": state["u"] + 0.0}

    def signals(self, state):
        x = self.cosine * state["u"][:, 0] + np.sqrt(1.0 - self.cosine**2) * state["u"][:, 1]
        return {"x": np.where(x > self.breaks, np.nan, x)}


def problem(p, cosine, cost=0.01, *, stack=None, twin=None, chunk=None, levels=None):
    below = {
        f"below_{k}": avrare.stl(f"always (x < {NormalDist().inv_cdf(1.0 - one)})")
        for k, one in enumerate(levels or [p])
    }
    own = avrare.Problem(stack or Turned(), below, steps=1, chunk=chunk)
    return own.with_twin(avrare.Problem(twin or Turned(cosine), below, steps=1, chunk=chunk), cost)


def test_equal_weights_give_the_exact_interval():
    weights = np.full(7, 1 / 500)
    exact = intervals.clopper_pearson(7, 500, 0.95)
    assert intervals.weighted_counts(weights, 500, 1 / 500, 0.95) == pytest.approx(exact, rel=1e-9)
    broken = intervals.weighted_counts(weights, 500, 1 / 500, 0.95, errors=np.full(3, 1 / 500))
    assert broken == pytest.approx(intervals.clopper_pearson(7, 500, 0.95, errors=3), rel=1e-9)
    nothing = intervals.weighted_counts(weights[:0], 500, 1 / 50, 0.95)
    assert nothing[0] == 0.0
    assert nothing[1] == pytest.approx(intervals.clopper_pearson(0, 50, 0.95)[1], rel=0.1)


def test_a_design_reruns_what_the_twin_fails_and_little_of_the_rest():
    rng = np.random.default_rng(1)
    u = rng.standard_normal(4000)
    robustness, violated = 2.0 - u, u > 2.0
    same = plan_design(violated[:, None], robustness[:, None], violated[:, None], 0.01)
    rates = same.bands[0].rates
    assert same.pays
    assert rates[0] == 1.0
    assert (np.diff(rates) <= 0.0).all()
    assert rates[-1] < 0.1
    assert same.correlations[0] == pytest.approx(1.0)
    other = rng.standard_normal(4000) > 2.0
    assert not plan_design(violated[:, None], robustness[:, None], other[:, None], 0.01).pays
    rows, factor = scale_rates(np.array([1.0, 0.1, 0.1]), 1.5)
    assert rows.sum() == pytest.approx(1.5)
    assert rows[0] == 1.0
    assert factor == pytest.approx(2.5)


def test_gain_at_the_cost_asked_for():
    result = avrare.estimate(problem(1e-2, 0.9999), "mfmc", rollouts=3000, seed=1)
    low, high = result.interval
    assert low < 1e-2 < high
    assert high - low < 0.6 * 2 * 1.96 * np.sqrt(1e-2 / 3000)
    twin = result.diagnostics["twin"]
    assert twin["tapes"] * 0.01 + twin["run_again"] == pytest.approx(2850, rel=0.04)
    assert result.failures.weights.sum() == pytest.approx(result.probability)
    assert "Monte Carlo would need" in {note.kind: note.text for note in result.notes}["twin"]


@pytest.mark.slow
@pytest.mark.parametrize(("cosine", "rollouts", "gain"), [(0.9965, 5000, 2.0), (0.0, 3000, 0.55)])
def test_unbiased_and_covers(cosine, rollouts, gain):
    pair, seeds, p = problem(1e-2, cosine), 60, 1e-2
    results = [avrare.estimate(pair, "mfmc", seed=seed, rollouts=rollouts) for seed in range(seeds)]
    values = np.array([one.probability for one in results])
    assert abs(deviation(values, p)) < 4.0
    covered = sum(one.interval[0] <= p <= one.interval[1] for one in results)
    assert coverage_at_most(covered, seeds, 0.95) > 1e-3
    assert p * (1.0 - p) / rollouts / np.mean((values - p) ** 2) > gain


def test_a_killed_estimate_resumes_with_the_same_bits(tmp_path):
    counted = Mortal(Turned(0.999), np.inf)
    pair = problem(2e-2, 0.999, 1 / 32, twin=counted, chunk=2000)
    whole = avrare.estimate(pair, "mfmc", rollouts=4000, seed=4)

    def attempt(_):
        pair = problem(2e-2, 0.999, 1 / 32, twin=Mortal(Turned(0.999), counted.lived - 6), chunk=2000)
        return avrare.estimate(pair, "mfmc", rollouts=4000, seed=4, checkpoint=tmp_path / "kept")

    result, kills = estimate_through_kills(attempt)
    assert kills > 0
    assert plain(result) == plain(whole)


def test_a_useless_twin_leaves_plain_monte_carlo():
    pair = problem(1e-2, -1.0)
    result = avrare.estimate(pair, "mfmc", rollouts=3000, seed=2)
    left = 3000 - int(0.05 * 3000 / 1.01) * 1.01
    same = avrare.estimate(pair, "mc", rollouts=int(left), seed=2)
    assert result.estimator == "mc"
    assert (result.probability, result.interval) == (same.probability, same.interval)
    assert result.rollouts == same.rollouts + 2 * int(0.05 * 3000 / 1.01)
    assert "promises a gain of only" in {note.kind: note.text for note in result.notes}["twin"]
    sample = FailureSample.of(result)
    assert sample.trials == same.rollouts
    assert sample.part_interval(np.ones(sample.size, dtype=bool))[1] == result.interval
    (note,) = avrare.estimate(pair, "mfmc", rollouts=200).notes
    assert "too few" in note.text


def test_several_specifications_share_their_rollouts():
    pair = problem(None, 0.999, levels=[2e-2, 5e-3])
    found = avrare.estimate_all(pair, "mfmc", rollouts=6000, seed=3)
    frequent, rare = found.values()
    assert frequent.rollouts == rare.rollouts
    for result, p in ((frequent, 2e-2), (rare, 5e-3)):
        assert result.interval[0] < p < result.interval[1]


def test_breakdowns_of_the_stack_widen_the_interval_and_those_of_the_twin_do_not():
    whole = avrare.estimate(problem(2e-2, 0.999), "mfmc", rollouts=3000, seed=5)
    broken = avrare.estimate(problem(2e-2, 0.999, stack=Turned(breaks=2.2)), "mfmc", rollouts=3000, seed=5)
    assert broken.errors > 0
    assert "errors" in broken.health
    assert broken.probability < whole.probability
    assert broken.interval[1] > 2e-2
    share = broken.error_share
    assert share == pytest.approx(1.0 - NormalDist().cdf(2.2), rel=0.15)
    none = replace(broken, error_share=0.0)
    ends = [combine(one, 3, None, dict.fromkeys(range(3), one)).interval[1] for one in (none, broken)]
    assert ends[1] - ends[0] == pytest.approx(share), "over an ensemble, too"
    other = avrare.estimate(problem(2e-2, 0.999, twin=Turned(0.999, 2.5)), "mfmc", rollouts=3000, seed=5)
    assert other.errors == 0
    assert other.interval[0] < 2e-2 < other.interval[1]
    assert "the twin broke down on" in {note.kind: note.text for note in other.notes}["twin"]
    never = avrare.estimate(problem(2e-2, 0.999, twin=Turned(0.999, -np.inf)), "mfmc", rollouts=3000, seed=5)
    assert never.estimator == "mc"
    assert never.errors == 0
    assert "the twin broke down on 148 of 148 tapes" in {note.kind: note.text for note in never.notes}["twin"]


def test_what_cannot_be_a_twin_is_said():
    below = avrare.stl("always (x < 2)")
    own = avrare.Problem(Turned(), below, steps=1)
    with pytest.raises(UsageError, match="needs a cheap twin"):
        avrare.estimate(own, "mfmc")
    longer = avrare.Problem(Turned(), below, steps=2)
    with pytest.raises(UsageError, match="2 steps instead of 1"):
        own.with_twin(longer)
    with pytest.raises(UsageError, match="no specification specification"):
        own.with_twin(avrare.Problem(Turned(), {"other": below}, steps=1))
    with pytest.raises(UsageError, match="between 0 and 1"):
        own.with_twin(own, 1.0)
    with pytest.raises(UsageError, match="clock"):
        avrare.estimate(own.with_twin(own, 0.1), "mfmc", budget="seconds=1")


def test_a_cost_that_is_missing_is_measured_for_the_error():
    own = avrare.Problem(Turned(), avrare.stl("always (x < 2)"), steps=1)
    cost = measure_cost(own, own)
    assert np.log2(cost) == int(np.log2(cost))
    with pytest.raises(UsageError, match="cost of the cheap twin is missing") as raised:
        avrare.estimate(own.with_twin(own), "mfmc", rollouts=100)
    assert "cheap: {cost: " in raised.value.hint


def test_a_checkpoint_belongs_to_one_share_of_the_pilot(tmp_path):
    def interrupt(info):
        raise Killed

    def estimate(pilot, progress):
        settings = {"seed": 1, "rollouts": 2000, "checkpoint": tmp_path / "checkpoint", "progress": progress}
        return avrare.estimate(problem(0.01, 0.9, chunk=500), "mfmc", pilot=pilot, **settings)

    with pytest.raises(Killed):
        estimate(0.05, interrupt)
    with pytest.raises(UsageError, match=r"another estimate: options\.pilot 0\.05 -> 0\.2"):
        estimate(0.2, False)
