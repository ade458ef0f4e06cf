"""Weights: P/q gives the truth, the paper's weights do not, and nobody else runs on weighted noise."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

import avrare
from avrare.base.errors import UsageError
from avrare.testing.static_problems import Static
from avrare_flows import transform_noise, weigh_noise
from avrare_flows.flow import Flow
from avrare_flows.laws import Joint
from avrare_flows.marginals import Exponential, LogNormal, Normal
from plain_systems import Sum, Total

FORMULA = avrare.stl("total < 10")
THREE = Joint([Exponential()] * 3)
EXACT = math.exp(-10.0) * 61.0
"""The sum of three Exp(1) reaches 10."""
WIDE = Flow("by hand", (), np.zeros(1), np.full(1, 1.2), samples=100)
"""N(0, 1.2^2)."""


@dataclass(frozen=True, eq=False)
class Stretched:
    """A flow that has the scale a tenth too large."""

    law: Joint
    note = "stretched"

    @property
    def noise_size(self):
        return self.law.noise_size

    def physical(self, z):
        return self.law.physical(1.1 * z)

    def warp(self, z):
        x, log_det = self.law.warp(1.1 * z)
        return x, log_det + self.noise_size * math.log(1.1)


def estimate(system, **options):
    return avrare.estimate(avrare.Problem(system, FORMULA, 0), "ess", seed=2, **{"runs": 20} | options)


def test_with_the_density_known_a_flawed_flow_gives_the_truth():
    flawed, right = Stretched(THREE), estimate(weigh_noise(Total(3), Stretched(THREE), THREE.log_density))
    error = right.relative_error * right.probability
    assert abs(right.probability - EXACT) < 3.0 * error
    assert error < 0.1 * EXACT
    assert list(right.health) == ["flow_tails"]
    assert len(right.diagnostics["weight_sizes"][0]) == len(right.diagnostics["levels"][0])
    wrong = estimate(transform_noise(Total(3), flawed))
    assert wrong.probability > 1.8 * EXACT
    assert wrong.health == {"model_error": "stretched"}


def test_a_density_up_to_a_constant_suffices():
    known = estimate(weigh_noise(Total(3), Stretched(THREE), THREE.log_density), runs=3)
    scaled = estimate(weigh_noise(Total(3), Stretched(THREE), lambda x: THREE.log_density(x) + 40.0), runs=3)
    assert scaled.probability == pytest.approx(known.probability, rel=1e-9)


def test_the_papers_weights_are_biased_for_an_exact_flow_and_give_a_warning():
    """Take a lognormal, sigma = 1/2: E[|det|, failure] / E[|det|] moves the normal number by sigma."""
    law, far = Joint([LogNormal(0.0, 0.5)]), 3.0
    system, formula = weigh_noise(Static(1), law, weights="paper"), f"u0 < {math.exp(0.5 * far)!r}"
    problem = avrare.Problem(system, avrare.stl(formula), 0)
    found = avrare.estimate(problem, "ess", seed=1, runs=20, chains=100)
    tilted = 0.5 * math.erfc((far - 0.5) / math.sqrt(2.0))
    error = found.relative_error * found.probability
    assert abs(found.probability - tilted) < 4.0 * error
    assert tilted > 4.0 * 0.5 * math.erfc(far / math.sqrt(2.0))
    assert "paper_weights" in found.health


def test_weights_are_those_of_all_rows():
    """Draw a walk of N(0, 1) steps from N(0, 1.2^2); the truth is from N(0, 1) itself."""

    def estimate_walk(system, seed, **options):
        problem = avrare.Problem(system, avrare.stl("always (x < 6)"), 4)
        return avrare.estimate(problem, "ess", seed=seed, **options)

    result = estimate_walk(weigh_noise(Sum(), WIDE, Joint([Normal()]).log_density), 3, runs=20)
    truth = estimate_walk(transform_noise(Sum(), Joint([Normal()])), 4, runs=20)
    spread = math.hypot(result.relative_error, truth.relative_error)
    assert abs(math.log(result.probability / truth.probability)) < 3.0 * spread
    assert spread < 0.2
    assert estimate_walk(transform_noise(Sum(), WIDE), 3).probability > 2.0 * truth.probability


def test_the_weight_of_a_tape_is_the_ratio_of_its_densities():
    walk = weigh_noise(Sum(), WIDE, Joint([Normal()]).log_density, initial=Joint([Normal(5.0)]))
    walk = walk.with_weights()
    z = np.random.default_rng(0).standard_normal((6, 3, 1))
    state = walk.initial(z[:, 0])
    assert walk.log_weights(state).tolist() == [0.0] * 6
    for t in (1, 2):
        state = walk.step(state, z[:, t])
    x = 1.2 * z[:, 1:, 0]
    expected = (-0.5 * x**2 + 0.5 * z[:, 1:, 0] ** 2 + math.log(1.2)).sum(axis=1)
    np.testing.assert_allclose(walk.log_weights(state), expected, rtol=1e-12, atol=1e-12)
    alone = walk.step(walk.step(walk.initial(z[2:3, 0]), z[2:3, 1]), z[2:3, 2])
    assert walk.log_weights(alone)[0] == walk.log_weights(state)[2]


def test_a_weight_that_is_not_a_number_is_a_fault():
    system = weigh_noise(Static(1), Joint([Normal()]), lambda x: np.where(x[:, 0] > 0, np.nan, 0.0))
    system = system.with_weights()
    assert system.faults(system.initial(np.array([[1.0], [-1.0]]))).tolist() == [True, False]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"weights": "papers"}, "unknown weights 'papers'"),
        ({}, "need log_density"),
        ({"weights": "paper", "log_density": THREE.log_density}, "take none"),
        ({"weights": "paper", "initial": Joint([Normal()])}, "1 numbers a row"),
    ],
)
def test_options_that_do_not_fit_are_refused(options, text):
    with pytest.raises(UsageError, match=text):
        weigh_noise(Total(3), THREE, **options)
