"""The naive proposal: what it draws, its density, and that a real model can be weighed against it."""

import numpy as np
import pytest

from avrare_gp_pem.config import NaivePemConfig, ParametricPemConfig
from avrare_gp_pem.runtime.models import build_naive, build_parametric


def drawn(model, world, seed=0):
    noise = np.random.default_rng(seed).standard_normal((len(world.step), model.noise_size))
    return noise, model.observe(world, noise)


def test_half_is_missed_and_errors_have_unit_size(make):
    world = make.random(20000, 3)
    _, seen = drawn(build_naive(NaivePemConfig(), make.scene(3)), world)
    assert seen.detected.mean() == pytest.approx(0.5, abs=0.01)
    for true, read in ((world.others.x, seen.x), (world.others.y, seen.y)):
        error = (read - true)[seen.detected]
        assert error.mean() == pytest.approx(0.0, abs=0.03)
        assert error.std() == pytest.approx(1.0, abs=0.02)
        assert np.isnan(read[~seen.detected]).all()


def test_log_prob_is_the_density(make):
    config = NaivePemConfig(detection=0.3, sd=0.7, speed_sd=0.2)
    model, world = build_naive(config, make.scene(1)), make.random(50, 1)
    noise, seen = drawn(model, world)
    seen_density = np.log(0.3) - 1.5 * np.log(2 * np.pi) - np.log(0.7 * 0.7 * 0.2)
    expected = np.where(
        seen.detected[:, 0], seen_density - 0.5 * (noise[:, 1:] ** 2).sum(axis=1), np.log(0.7)
    )
    assert 0 < seen.detected.mean() < 1
    np.testing.assert_allclose(model.log_prob(world, seen), expected, rtol=1e-9)


def test_weights_of_a_real_model_have_mean_one(make):
    """Check E_q[p/q] = 1 of one observation, over what the target reports, with its misses and its tails."""
    scene, world = make.scene(1), make.world([[25.0, 2.0, 0.3]], n=200_000)
    target = build_parametric(
        ParametricPemConfig(longitudinal_scale=(0.5, 0.0), lateral_scale=(0.5, 0.0)), scene
    )
    proposal = build_naive(NaivePemConfig(sd=1.5), scene)
    _, seen = drawn(proposal, world)
    weights = np.exp(target.log_prob(world, seen) - proposal.log_prob(world, seen))
    error = weights.std() / np.sqrt(len(weights))
    assert error < 0.05
    # heavy tails beyond what was drawn: a little below 1, never above
    assert -0.1 < weights.mean() - 1 < 4 * error
