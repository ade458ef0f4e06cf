"""Importance scores: adapted, monotone, and no part of the answer."""

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.rollout.noise import NoiseSource
from avrare.testing import faulty_systems as systems
from rollout_requests import fresh

STEPS = 12
NOISE = NoiseSource(4, 1)


def simulate(score, formula="always (x < 0.3)", rows=50, system=None):
    problem = avrare.Problem(system or systems.Walk(), avrare.stl(formula), STEPS, score)
    return problem.simulate(NOISE, fresh(rows))


def test_function_sees_the_signals_so_far():
    seen = []

    def latest(signals, t):
        seen.append((t, signals["x"].shape))
        return signals["x"][:, t]

    outcome = simulate(latest, "eventually (x > 0.3)")
    assert seen == [(t, (50, t + 1)) for t in range(STEPS + 1)]
    x = 0.1 * NOISE.normals(0, 0, np.arange(50)[:, None], np.arange(STEPS + 1))[:, :, 0]
    x[:, 0] = 0.0
    expected = np.maximum.accumulate(np.cumsum(x, axis=1), axis=1)
    np.testing.assert_allclose(outcome.scores, expected, atol=1e-12)


def test_score_does_not_change_the_verdict():
    plain = simulate(None)
    for score in ("robustness", "margin", odd_systems.height):
        np.testing.assert_array_equal(simulate(score).violated, plain.violated)
        np.testing.assert_array_equal(simulate(score).robustness, plain.robustness)


@pytest.mark.parametrize("wrong", [lambda signals, t: signals["x"], lambda signals, t: 1.0])
def test_function_of_the_wrong_shape(wrong):
    with pytest.raises(avrare.UsageError, match="score function"):
        simulate(wrong)


class Approach(systems.Walk):
    """Comes near the limit whatever the noise: x = 0, 1, ..., and the noise adds a little."""

    def step(self, state, noise):
        return {"x": state["x"] + 1.0 + 0.01 * noise[:, 0]}


def test_margin_is_relative_to_the_noise_free_rollout():
    """Spread particles whose robustness is tied: the last sample decides it whatever the noise."""
    outcome = simulate("margin", "always (x < 12.01)", system=Approach(), rows=200)
    failed = outcome.violated[:, 0]
    assert 0 < failed.sum() < 200
    assert (outcome.scores[failed, -1] >= 1.0).all()
    assert (outcome.scores[:, 0] == 0.0).all()
    assert (np.diff(outcome.scores, axis=1) >= 0.0).all()
    assert len(np.unique(outcome.scores[:, 3])) > 50


def test_margin_needs_always_phi():
    with pytest.raises(avrare.UsageError, match="margin"):
        simulate("margin", "eventually (x > 0.3)")


def test_margin_of_a_rule_that_the_noise_free_rollout_breaks():
    broken, own = (simulate(score, "always (x < -1)") for score in ("margin", "robustness"))
    np.testing.assert_array_equal(broken.scores, own.scores)


class Quiet(systems.Walk):
    """Breaks down where there is no noise at all."""

    def step(self, state, noise):
        return {"x": np.where(noise[:, 0] == 0.0, np.nan, state["x"] + 0.1 * noise[:, 0])}


def test_margin_where_the_noise_free_rollout_ends_with_an_error():
    broken, own = (simulate(score, system=Quiet()) for score in ("margin", "robustness"))
    np.testing.assert_array_equal(broken.scores, own.scores)


def test_gamma_is_zero_at_failure_for_the_score_that_is_used():
    margin, fallen_back = (
        avrare.Problem(systems.Walk(), avrare.stl(f"always (x < {limit})"), STEPS, "margin")
        for limit in (0.3, -1)
    )
    assert (margin.gamma(1.0), margin.gamma(0.25)) == (0.0, 0.75)
    assert fallen_back.gamma(-0.4) == 0.4


def test_a_score_function_that_raises_is_named():
    with pytest.raises(avrare.UsageError, match="score function raised at step 0: KeyError"):
        simulate(lambda signals, t: signals["y"])


def test_a_formula_as_score_orders_by_nearness_to_failure():
    guided = simulate(avrare.stl("always (x < 0.5)"), "eventually (x > 9)")
    own = simulate("robustness", "always (x < 0.5)")
    np.testing.assert_array_equal(guided.scores, own.scores)
    assert guided.violated.all()
    assert not own.violated.all()
