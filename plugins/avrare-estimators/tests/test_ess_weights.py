"""Nested levels of a system that reports weights: what is drawn is N(0, s^2), what is meant N(0, 1)."""

from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import ClassVar

import numpy as np
import pytest

import avrare
from avrare_estimators.common.chains.levels import effective_samples, relative_weights

TRUTH = NormalDist().cdf(-3.5)


@dataclass(frozen=True)
class Place:
    x: np.ndarray
    log_weight: np.ndarray


@dataclass(frozen=True, eq=False)
class Wide:
    spread: float
    constant: float = 0.0
    asked: bool = False
    noise_size: int = 1
    warnings: ClassVar = {"drawn_wide": "the law is another one"}

    def with_weights(self):
        return replace(self, asked=True)

    def initial(self, noise):
        assert self.asked
        x = self.spread * noise[:, 0]
        return Place(x, 0.5 * noise[:, 0] ** 2 - 0.5 * x**2 + self.constant)

    def step(self, state, noise):
        return state

    def signals(self, state):
        return {"x": state.x}

    def log_weights(self, state):
        return state.log_weight


def estimate(system, **options):
    problem = avrare.Problem(system, avrare.stl("x < 3.5"), 0)
    options = {"runs": 40, "chains": 30, "suppress": ["few_roots"]} | options
    return avrare.estimate(problem, "ess", seed=1, **options)


@pytest.mark.parametrize("spread", [0.9, 1.2])
@pytest.mark.parametrize("second_pass", [True, False])
def test_weights_give_the_intended_law(spread, second_pass):
    found = estimate(Wide(spread), second_pass=second_pass)
    error = found.relative_error * found.probability
    assert abs(found.probability - TRUTH) < 3.5 * error
    assert error < 0.15 * TRUTH
    drawn = NormalDist().cdf(-3.5 / spread)
    assert abs(found.probability - drawn) > 5.0 * error
    assert found.health == Wide.warnings
    sizes, largest = found.diagnostics["weight_sizes"], found.diagnostics["largest_weights"]
    assert all(1.0 <= size <= found.diagnostics["samples"] for run in sizes for size in run)
    assert all(0.0 < share < 0.3 for run in largest for share in run)


def test_the_interval_of_a_single_run_includes_the_scatter_of_weights():
    narrow, wide = (estimate(Wide(spread), runs=1) for spread in (1.2, 2.5))
    assert narrow.relative_error < wide.relative_error
    assert "weight_degenerate" in estimate(Wide(0.5), runs=4).health


def test_with_weights_the_interval_without_levels_is_not_binomial():
    problem = avrare.Problem(Wide(1.5), avrare.stl("x < 1"), 0)
    found = avrare.estimate(problem, "ess", seed=2, runs=20)
    low, high = found.interval
    assert low < NormalDist().cdf(-1.0) < high
    assert high < 1.3 * low


def test_relative_weights_have_mean_one_and_bear_extremes():
    logs = np.array([[0.0, 0.0, 0.0], [1e4, 1e4 - 1.0, -np.inf], [-np.inf] * 3])
    found = relative_weights(logs)
    assert found[0].tolist() == [1.0, 1.0, 1.0]
    assert found[1] == pytest.approx(3.0 * np.array([1.0, np.exp(-1.0), 0.0]) / (1.0 + np.exp(-1.0)))
    assert found[2].tolist() == [0.0, 0.0, 0.0]


def test_effective_sizes_of_weights_are_those_of_a_ratio():
    """Compare with the scatter of many independent ratios."""
    rng = np.random.default_rng(1)
    weights = rng.exponential(size=(2000, 1, 400))
    weights /= weights.mean(axis=(1, 2), keepdims=True)
    hit = rng.random(weights.shape) < 0.2 + 0.1 * (weights > 1.0)
    shares = (weights * hit).mean(axis=(1, 2))
    worth = shares.mean() * (1.0 - shares.mean()) / shares.var()
    assert np.median(effective_samples(hit, weights)) == pytest.approx(worth, rel=0.1)
