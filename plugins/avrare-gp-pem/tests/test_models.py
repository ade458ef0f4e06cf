"""All models behind the same interface."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from avrare.base.batch import take
from avrare.base.errors import UsageError
from avrare_gp_pem.config import GpPemConfig, NaivePemConfig, ParametricPemConfig
from avrare_gp_pem.runtime.models import build_gp, build_naive, build_parametric
from avrare_gp_pem.runtime.store import FOLDER
from avrare_gp_pem.runtime.student_t import student
from perception_scenes import change_file

FIELDS = ("detected", "x", "y", "speed_x")


def draws(model, world, seed=0):
    noise = np.random.default_rng(seed).standard_normal((len(world.step), model.noise_size))
    return noise, model.observe(world, noise)


def test_missed_is_nan_and_nothing_else(build, make):
    _, observation = draws(build(make.scene(3)), make.random(300, 3))
    assert 0 < observation.detected.mean() < 1
    for name in FIELDS[1:]:
        np.testing.assert_array_equal(np.isnan(getattr(observation, name)), ~observation.detected)


@pytest.mark.filterwarnings("error")
def test_an_absurd_world_stays_in_its_row(build, make):
    model, world = build(make.scene(3)), make.random(4, 3)
    x = world.ego.x.copy()
    x[1] = np.nan
    _, observation = draws(model, dataclasses.replace(world, ego=dataclasses.replace(world.ego, x=x)))
    _, whole = draws(model, world)
    others = [0, 2, 3]
    assert not observation.detected[1].any()
    np.testing.assert_array_equal(observation.detected[others], whole.detected[others])
    np.testing.assert_array_equal(observation.x[others], whole.x[others])


@pytest.mark.parametrize("index", [slice(0, 1), slice(3, 150), [77], list(range(199, -1, -1)), [5, 5, 198]])
def test_rows_do_not_depend_on_their_neighbours(build, make, index):
    model, world = build(make.scene(3)), make.random(200, 3)
    noise, whole = draws(model, world)
    part = model.observe(take(world, index), noise[index])
    for name in FIELDS:
        assert getattr(part, name).tobytes() == getattr(whole, name)[index].tobytes()
    likelihood = model.log_prob(world, whole)[index]
    assert model.log_prob(take(world, index), part).tobytes() == likelihood.tobytes()


@pytest.mark.parametrize("distance", [10.0, 40.0, 55.0])
def test_detection_frequency_is_the_probability(build, make, distance):
    model, n = build(make.scene(1)), 20000
    world = make.world([[distance, 0.0, 0.0]], n=n)
    probability = model.law(take(world, slice(0, 1))).detect.item()
    error = np.sqrt(probability * (1 - probability) / n)
    assert abs(draws(model, world)[1].detected.mean() - probability) < 4 * error + 1e-9


@pytest.mark.parametrize("heading", [0.0, 1.2])
def test_spread_of_errors_is_the_predicted_one(build, make, heading):
    model, n = build(make.scene(1)), 100000
    world = make.turned(make.world([[25.0, 2.0, 0.0]], n=n), heading)
    law, (_, seen) = model.law(take(world, slice(0, 1))), draws(model, world)
    dx, dy = world.others.x - seen.x, world.others.y - seen.y
    cos, sin = np.cos(heading), np.sin(heading)
    for axis, error in enumerate((cos * dx + sin * dy, cos * dy - sin * dx)):
        error = error[seen.detected] - law.location[0, 0, axis]
        scale = law.scale[0, 0, axis]
        t = np.linspace(-law.limit / scale, law.limit / scale, 400001)
        density = np.exp(student(law.dof[axis]).truncated_log_density(t, np.full_like(t, law.limit / scale)))
        sd = scale * np.sqrt(np.trapezoid(density * t * t, t))
        assert error.std() == pytest.approx(sd, rel=0.1)  # heavy tails: a sample sd converges slowly
        for k in (0.5, 1, 3, 10):
            tail = np.trapezoid(np.where(np.abs(t) > k, density, 0.0), t)
            assert abs((np.abs(error) > k * scale).mean() - tail) < 5 * np.sqrt(tail / n) + 1e-4


def test_speed_is_along_the_world_axis(build, make):
    model = build(make.scene(1), speed_sd=0.5)
    world = make.world([[10.0, 0.0, 1.0]], n=20000, speed=12.0)
    _, seen = draws(model, world)
    error = seen.speed_x[seen.detected] - 12 * np.cos(1.0)
    assert abs(error.mean()) < 0.02
    assert error.std() == pytest.approx(0.5, rel=0.03)


def test_parametric_is_its_formula(make):
    model = build_parametric(ParametricPemConfig(), make.scene(2))
    law = model.law(make.world([[40.0, 0.0, 0.0], [60.0, 0.0, 0.0]]))
    assert law.detect[0, 0] == pytest.approx(0.986 / (1 + np.exp((40 - 51.6) / 7.6)))
    assert law.detect[0, 1] == 0.0  # hidden
    np.testing.assert_allclose(law.scale[0, 0], [0.047 + 0.006 * 40, 0.024 + 0.0039 * 40])


def test_unknown_model_is_a_usage_error(make, tmp_path):
    with pytest.raises(UsageError) as caught:
        build_gp(GpPemConfig(model="pointpilars"), make.scene(1))
    assert "pointpillars" in caught.value.hint
    with pytest.raises(UsageError, match="no such file"):
        build_gp(GpPemConfig(model=str(tmp_path / "none.npz")), make.scene(1))
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"nonsense")
    with pytest.raises(UsageError, match=r"not a perception model: not an \.npz file"):
        build_gp(GpPemConfig(model=str(broken)), make.scene(1))
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(UsageError, match="'format' is missing"):
        build_gp(GpPemConfig(model=str(tmp_path / "other.npz")), make.scene(1))


def test_weather_multiplies_errors_and_the_odds_of_a_miss(build, make):
    model, world = build(make.scene(2)), make.random(2000, 2)
    clear = model.law(world)
    law = clear.in_weather(np.full(2000, 3.0))
    np.testing.assert_allclose(law.miss * clear.detect, 3.0 * clear.miss * law.detect)
    np.testing.assert_allclose(law.scale, 3.0 * clear.scale)
    one = dataclasses.replace(world, weather=np.ones(2000))
    for name in FIELDS:
        same = (getattr(draws(model, other)[1], name) for other in (world, one))
        np.testing.assert_allclose(*same, rtol=1e-12)
    rainy = dataclasses.replace(world, weather=np.full(2000, 3.0))
    _, seen = draws(model, rainy)
    assert seen.detected.mean() < draws(model, world)[1].detected.mean()
    np.testing.assert_array_equal(model.log_prob(rainy, seen), law.log_prob(rainy, seen))


@pytest.mark.parametrize(
    "change",
    [{"clean_dof": [-3.5, 0.05]}, {"clean_dof": [2.0, 300.0]}, {"clean_limit": -1.0}, {"yaw_dof": 0.0}],
    ids=str,
)
def test_damaged_laws_of_errors_are_refused(make, tmp_path, change):
    path = Path(shutil.copy(FOLDER / "measured.npz", tmp_path))
    change_file(path, **change)
    with pytest.raises(UsageError, match="degrees of freedom not from 1 to 30"):
        build_gp(GpPemConfig(model=str(path)), make.scene(1))


def test_half_is_missed_and_errors_have_unit_size(make):
    world = make.random(20000, 3)
    _, seen = draws(build_naive(NaivePemConfig(), make.scene(3)), world)
    assert seen.detected.mean() == pytest.approx(0.5, abs=0.01)
    for true, read in ((world.others.x, seen.x), (world.others.y, seen.y)):
        error = (read - true)[seen.detected]
        assert error.mean() == pytest.approx(0.0, abs=0.03)
        assert error.std() == pytest.approx(1.0, abs=0.02)
        assert np.isnan(read[~seen.detected]).all()


def test_log_prob_is_the_density(make):
    config = NaivePemConfig(detection=0.3, sd=0.7, speed_sd=0.2)
    model, world = build_naive(config, make.scene(1)), make.random(50, 1)
    noise, seen = draws(model, world)
    seen_density = np.log(0.3) - 1.5 * np.log(2 * np.pi) - np.log(0.7 * 0.7 * 0.2)
    seen_density = seen_density - 0.5 * (noise[:, 1:] ** 2).sum(axis=1)
    expected = np.where(seen.detected[:, 0], seen_density, np.log(0.7))
    assert 0 < seen.detected.mean() < 1
    np.testing.assert_allclose(model.log_prob(world, seen), expected, rtol=1e-9)


def test_weights_of_a_real_model_have_mean_one(make):
    """Check E_q[p/q] = 1 of one observation, over what the target reports, with its misses and its tails."""
    scene, world = make.scene(1), make.world([[25.0, 2.0, 0.3]], n=200_000)
    config = ParametricPemConfig(longitudinal_scale=(0.5, 0.0), lateral_scale=(0.5, 0.0))
    target = build_parametric(config, scene)
    proposal = build_naive(NaivePemConfig(sd=1.5), scene)
    _, seen = draws(proposal, world)
    weights = np.exp(target.log_prob(world, seen) - proposal.log_prob(world, seen))
    error = weights.std() / np.sqrt(len(weights))
    assert error < 0.05
    # heavy tails beyond what was drawn: a little below 1, never above
    assert -0.1 < weights.mean() - 1 < 4 * error
