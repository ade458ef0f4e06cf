"""Kernel ``bayesian``: its process, its acquisition functions, its rounds."""

import numpy as np
import pytest
from studies.stationarity import drift, exact_starts

import avrare
from avrare.testing.problems import four_branch
from avrare_estimators.ess.build import build_kernel
from avrare_estimators.ess.config import EssConfig
from avrare_estimators.ess.kernels.stl_ess import GRID, Acquisition, BayesianKernel, Posterior

ANGLES = np.array([[0.0, 2.0 * np.pi, 1.0, 4.0, 5.2], [0.0, 2.0 * np.pi, 0.3, 2.0, 3.0]])
SCORES = np.array([[1.0, 1.0, -0.5, 0.7, 2.0], [0.0, 0.0, 3.0, 1.0, -2.0]])


def test_the_process_is_that_of_scikit_learn():
    from sklearn import gaussian_process as processes

    posterior = Posterior.fit(ANGLES, SCORES)
    for i in range(2):
        matern = processes.kernels.Matern(1.0, "fixed", nu=2.5)
        process = processes.GaussianProcessRegressor(matern, alpha=1e-4)
        process.fit(ANGLES[i][:, None], (SCORES[i] - SCORES[i].mean()) / SCORES[i].std())
        mean, spread = process.predict(GRID[:, None], return_std=True)
        np.testing.assert_allclose(posterior.mean[i], mean, atol=1e-9)
        np.testing.assert_allclose(posterior.spread[i], spread, atol=1e-9)
        assert posterior.standardise(SCORES[:, 0])[i] == pytest.approx(posterior.mean[i][0], abs=0.3)


@pytest.mark.parametrize("xi", [0.0, 0.4])
def test_acquisitions_are_means_over_the_process(xi):
    mean, spread, best = np.array([[0.2, -1.0, 1.5]]), np.array([[0.5, 1.2, 0.1]]), np.array([1.0])
    draws = mean + spread * np.random.default_rng(0).normal(size=(400_000, 1, 3))[:, 0]
    gain = draws - best - xi
    expected = Acquisition("ei", xi=xi)(mean, spread, best)
    np.testing.assert_allclose(expected[0], np.maximum(gain, 0.0).mean(axis=0), atol=2e-3)
    ratio = Acquisition("poi", xi=xi)(mean, spread, best)
    share = (gain > 0.0).mean(axis=0)
    assert np.argsort(ratio[0]).tolist() == np.argsort(share).tolist()
    bound = Acquisition("ucb", kappa=2.0)(mean, spread, best)
    assert (draws <= bound[0]).mean(axis=0) == pytest.approx(0.97725, abs=2e-3)


def test_xi_and_kappa_lead_away_from_the_best_score():
    posterior = Posterior.fit(ANGLES[:1], SCORES[:1])

    def distance(acquisition):
        return abs(posterior.most_promising(acquisition)[0] - 5.2)

    assert distance(Acquisition("ucb", kappa=0.0)) < 0.7 < distance(Acquisition("ucb", kappa=5.0))
    assert distance(Acquisition("poi", xi=0.01)) < 0.7 < distance(Acquisition("poi", xi=3.0))
    assert Acquisition("ei", xi=0.4).exploiting() == Acquisition("ei", kappa=1.0, xi=0.0)


@pytest.mark.parametrize("acquisition", ["ucb", "ei", "poi"])
def test_every_acquisition_leaves_the_set(acquisition):
    problem = four_branch(4.0).problem()
    starts = exact_starts(problem, 0.0, 600, seed=5)
    outcome = drift(problem, BayesianKernel(Acquisition(acquisition)), (), starts, 0.0, 3)
    assert outcome.outside > 0.01, outcome


def test_certainty_ends_a_round():
    problem = four_branch(4.0).problem()
    starts = exact_starts(problem, 0.0, 300, seed=5)

    def cost(uncertainty):
        return drift(problem, BayesianKernel(uncertainty=uncertainty), (), starts, 0.0, 2).rollouts

    assert cost(0.0) >= 7.0
    assert cost(0.0) > cost(0.5) + 0.2 > cost(10.0)
    assert cost(10.0) >= 2.0, "one rollout to learn from, one to go"


def test_options_reach_the_kernel():
    options = {"acquisition": {"name": "ei", "xi": 0.1}, "points": 9, "uncertainty": 0.2}
    kernel = build_kernel(EssConfig(kernel={"name": "bayesian", **options}).kernel)
    assert isinstance(kernel, BayesianKernel)
    assert (kernel.acquisition, kernel.points, kernel.uncertainty) == (Acquisition("ei", xi=0.1), 9, 0.2)
    assert kernel.rollouts == 10.0


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"kernel": {"name": "pcn", "acquisition": "ei"}}, "unknown option 'kernel.acquisition'"),
        ({"kernel": {"name": "shrink", "points": 9}}, "unknown option 'kernel.points'"),
        (
            {"kernel": {"name": "bayesian", "acquisition": {"name": "ucb", "xi": 0.1}}},
            "'kernel.acquisition.xi'",
        ),
    ],
)
def test_options_of_other_kernels_are_refused(options, text):
    with pytest.raises(avrare.UsageError, match=text):
        avrare.estimate(four_branch(4.0).problem(), "ess", **options)
