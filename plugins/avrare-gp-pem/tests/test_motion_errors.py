"""Errors of the speed across the road and of headings."""

import math
from dataclasses import replace

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_gp_pem.config import GpPemConfig, ParametricPemConfig
from avrare_gp_pem.runtime.models import build_gp, build_parametric
from avrare_gp_pem.runtime.persistence import PersistentPem
from avrare_gp_pem.runtime.store import load, locate, save

HEADING = {"flips": 0.2, "scale": (0.05, 0.0), "dof": 4.0}
BOTH = {"speed_y_sd": 0.4, "heading": HEADING}


def seen(make, n=20_000, model=None, seed=0, **options):
    model = model or build_parametric(ParametricPemConfig(**options), make.scene(1))
    world = make.world([[10.0, 1.0, 0.1]], n=n)
    noise = np.random.default_rng(seed).standard_normal((n, model.noise_size))
    noise[:, 0] = -8.0
    return model, world, model.observe(world, noise)


def test_places_stay_the_same(build, make):
    plain, more = build(make.scene(2)), build(make.scene(2), **BOTH)
    assert more.noise_size == 8 + 2 * 3 == len(more.noise_names) == len(more.perfect_noise)
    noise = np.random.default_rng(1).standard_normal((30, 14))
    world = make.random(30, 2)
    one, other = plain.observe(world, noise[:, :8]), more.observe(world, noise)
    for name in ("detected", "x", "y", "speed_x"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
    for part in (other.speed_y, other.heading):
        np.testing.assert_array_equal(np.isnan(part), ~other.detected)


def test_the_errors_have_their_laws(make):
    _, _, observation = seen(make, **BOTH)
    across = observation.speed_y[:, 0] - 10.0 * math.sin(0.1)
    assert across.mean() == pytest.approx(0.0, abs=4 * 0.4 / math.sqrt(20_000))
    assert across.std() == pytest.approx(0.4, rel=0.02)
    error = (observation.heading[:, 0] - 0.1 + np.pi) % (2 * np.pi) - np.pi
    flipped = np.abs(error) > np.pi / 2
    assert flipped.mean() == pytest.approx(0.2, abs=0.012)
    assert np.median(np.abs(error[~flipped])) == pytest.approx(0.05 * 0.741, rel=0.05)  # of Student-t with 4


def test_the_density_is_that_of_the_draws(make):
    model, world, observation = seen(make, speed_sd=0.0, **BOTH)
    plain = build_parametric(ParametricPemConfig(speed_sd=0.0), make.scene(1))
    extra = model.log_prob(world, observation) - plain.log_prob(world, observation)
    error = (0.1 - observation.heading[:, 0] + np.pi) % (2 * np.pi) - np.pi
    inside = (np.abs(error) < 0.1) & (np.abs(observation.speed_y[:, 0] - 10 * math.sin(0.1)) < 0.5)
    weights = np.where(inside, np.exp(-extra), 0.0)  # its mean is the area of the box
    assert weights.mean() == pytest.approx(0.2 * 1.0, abs=4 * weights.std() / math.sqrt(len(weights)))


def test_headings_may_last_and_come_from_the_data(make):
    options = {"model": "measured", "heading": "measured", "persistence": {"heading": 1.0}}
    model = build_gp(GpPemConfig(**options), make.scene(2))
    assert isinstance(model, PersistentPem)
    np.testing.assert_array_equal(model.correlation[:8], 0.0)
    np.testing.assert_allclose(model.correlation[8:], math.exp(-0.1))
    names = [f"{kind} of car{k}" for k in range(2) for kind in ("flip of heading", "heading error")]
    assert [name for name in model.noise_names if "heading" in name] == names


def test_perfect_noise_turns_nothing(make):
    model = build_parametric(ParametricPemConfig(**BOTH), make.scene(1))
    world = make.world([[10.0, 1.0, 0.1]])
    observation = model.observe(world, np.array([model.perfect_noise]))
    assert observation.heading[0, 0] == pytest.approx(0.1)
    assert observation.speed_y[0, 0] == pytest.approx(10.0 * math.sin(0.1))


def test_ratios_of_other_options_stay_and_those_of_these_are_refused(make):
    models, plain = (
        [
            build_parametric(ParametricPemConfig(**more, miss_scale=scale), make.scene(1))
            for scale in (1.0, 1.2)
        ]
        for more in (BOTH, {})
    )
    world = make.world([[30.0, 1.0, 0.1]], n=5)
    noise = np.random.default_rng(2).standard_normal((5, 7))
    ratio, _ = models[0].log_ratio(world, noise, None, models[1], None)
    expected, _ = plain[0].log_ratio(world, noise[:, :4], None, plain[1], None)
    np.testing.assert_array_equal(ratio, expected)
    other = build_parametric(ParametricPemConfig(speed_y_sd=0.5, heading=HEADING), make.scene(1))
    with pytest.raises(UsageError, match="no density ratio"):
        models[0].log_ratio(world, noise, None, other, None)


def test_a_model_without_headings_in_its_data_says_so(make, tmp_path):
    save(tmp_path / "a.npz", replace(load(locate("measured")), yaw=None))
    with pytest.raises(UsageError, match="no measured errors of heading"):
        build_gp(GpPemConfig(model=str(tmp_path / "a.npz"), heading="measured"), make.scene(1))
