"""Errors that last: each observation keeps its law, rows stay apart, and misses come in longer runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import stats

from avrare.base.batch import take
from avrare.base.errors import ScenarioError, UsageError
from avrare.protocols import PerceptionErrorModel, adapt, overrides
from avrare.scenario.load import load
from avrare_gp_pem.config import GpPemConfig, NaivePemConfig, Persistence
from avrare_gp_pem.runtime import store
from avrare_gp_pem.runtime.models import build_gp, build_naive
from avrare_gp_pem.runtime.persistence import PersistentPem
from avrare_gp_pem.runtime.variant import MeasuredPersistence
from perception_scenes import follow

FIELDS = ("detected", "x", "y", "speed_x")
LANE_CHANGE = Path(__file__).parents[3] / "scenarios" / "lane_change_published.yaml"
ALL = {"detection": 0.3, "position": 0.5, "speed": 0.1}
LASTING = {"detection": 0.3, "detection_lasting": 0.4, "position": 0.5, "position_lasting": 0.2}


def naive(scene, **persistence):
    return build_naive(NaivePemConfig(persistence=persistence), scene)


def course(model, world, steps):
    """Return noise, observations and latent numbers of steps 1.., the world standing still."""
    noise, seen, memories = follow(model, world, steps)
    return noise, seen, np.stack([model.latent(memory) for memory in memories])


@pytest.mark.parametrize("persistence", [{}, {"detection": 0.0, "position": 0.0, "speed": 0.0}])
def test_without_persistence_it_is_the_model_itself(build, make, persistence):
    model = build(make.scene(2), persistence=persistence)
    assert type(model) is type(build(make.scene(2)))
    assert hasattr(model, "log_prob")
    assert not overrides(adapt(PerceptionErrorModel, model), PerceptionErrorModel.follow)


def test_without_a_past_it_observes_as_the_model_itself(build, make):
    world, scene = make.random(50, 2), make.scene(2)
    noise = np.random.default_rng(3).standard_normal((50, 8))
    one, other = build(scene, persistence=ALL).observe(world, noise), build(scene).observe(world, noise)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_a_channel_that_is_off_keeps_its_bits(build, make):
    world, scene = make.random(200, 2), make.scene(2)
    model, plain = build(scene, persistence={"position": 0.5}), build(scene)
    noise, seen, _ = course(model, world, 4)
    for row, observation in zip(noise[1:], seen, strict=True):
        anew = plain.observe(world, row)
        assert observation.detected.tobytes() == anew.detected.tobytes()
        assert observation.speed_x.tobytes() == anew.speed_x.tobytes()
        assert (observation.x != anew.x)[observation.detected].all()


def test_every_observation_has_the_law_of_the_model_itself(build, make):
    n, scene = 4000, make.scene(1)
    world = make.world([[40.0, 2.0, 0.3]], n=n)
    plain = build(scene)
    rate = plain.law(take(world, slice(0, 1))).detect.item()
    anew = plain.observe(world, np.random.default_rng(8).standard_normal((n, 4)))
    _, seen, _ = course(build(scene, persistence=ALL), world, 10)
    assert 0.5 < rate < 0.95
    for observation in (seen[0], seen[4], seen[9]):
        assert abs(observation.detected.mean() - rate) < 4 * np.sqrt(rate * (1 - rate) / n)
        for name in FIELDS[1:]:
            ours, theirs = (getattr(one, name)[one.detected] for one in (observation, anew))
            assert stats.ks_2samp(ours, theirs).pvalue > 1e-3


def test_runs_of_misses_grow_and_their_share_does_not(make):
    world, lengths, shares = make.world([[20.0, 0.0, 0.0]], n=2000), [], []
    for tau in (1e-6, 0.2, 0.5, 1.0):
        _, seen, _ = course(naive(make.scene(1), detection=tau), world, 60)
        missed = np.stack([~one.detected[:, 0] for one in seen])
        starts = missed[0].sum() + (missed[1:] & ~missed[:-1]).sum()
        lengths.append(missed.sum() / starts)
        shares.append(missed.mean())
    assert lengths[0] == pytest.approx(2.0, rel=0.05)  # a fair coin
    # P(next is seen | missed) of a correlation rho = arccos(rho) / pi; runs are cut off at 60 steps
    expected = [np.pi / np.arccos(np.exp(-0.1 / tau)) for tau in (0.2, 0.5, 1.0)]
    np.testing.assert_allclose(lengths[1:], expected, rtol=0.12)
    np.testing.assert_allclose(shares, 0.5, atol=0.02)


def test_a_lasting_part_stays_and_every_number_is_standard_normal(make):
    n, dt = 40_000, 0.1
    model = naive(make.scene(1), **LASTING)
    _, _, latents = course(model, make.world([[20.0, 0.0, 0.0]], n=n), 21)
    seconds, lasting = np.array([0.3, 0.5, 0.5]), np.array([0.4, 0.2, 0.2])
    for first, lag in ((0, 1), (0, 5), (0, 20), (8, 12)):
        found = (latents[first] * latents[first + lag]).mean(axis=0)
        expected = lasting + (1 - lasting) * np.exp(-lag * dt / seconds)
        np.testing.assert_allclose(found, [*expected, 0.0], atol=5 / np.sqrt(n))
    for step in (0, 1, 20):
        for channel in range(4):
            assert stats.kstest(latents[step, ::8, channel], "norm").pvalue > 1e-3


def test_without_a_lasting_part_the_sequence_begins_with_the_first_numbers(make):
    model = naive(make.scene(1), position=0.5)
    noise, _, latents = course(model, make.world([[20.0, 0.0, 0.0]], n=5), 1)
    rho = np.exp(-0.1 / 0.5)
    expected = rho * noise[0][:, 1] + np.sqrt(1 - rho**2) * noise[1][:, 1]
    np.testing.assert_allclose(latents[0][:, 1], expected, rtol=1e-12)


def test_measured_persistence_is_that_of_the_model_file(tmp_path, make):
    fitted = store.load(store.locate("best"))
    with pytest.raises(UsageError, match="no measured persistence"):
        build_gp(GpPemConfig(model="best", persistence="measured"), make.scene(2))
    measured = MeasuredPersistence(np.array([0.9, 0.3]), np.array([0.6, 0.1]))
    store.save(tmp_path / "a.npz", replace(fitted, persistence=measured))
    given = {"detection": 0.9, "detection_lasting": 0.3, "position": 0.6, "position_lasting": 0.1}
    configs = (
        GpPemConfig(model=str(tmp_path / "a.npz"), persistence=part) for part in ("measured", given, {})
    )
    one, other, plain = (build_gp(config, make.scene(2)) for config in configs)
    assert isinstance(one, PersistentPem)
    for name in ("correlation", "innovation", "lasting"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert not isinstance(plain, PersistentPem)  # only when asked


@pytest.mark.parametrize("value", [-0.1, float("inf"), float("nan")])
def test_time_constants_are_checked(value):
    with pytest.raises(ValidationError):
        Persistence(detection=value)
    with pytest.raises(ValidationError):
        Persistence(detection_lasting=value)


def test_a_scenario_sets_persistence_and_mistakes_have_a_place():
    scenario = load(LANE_CHANGE, ["perception.persistence.detection=0.3"])
    assert scenario.perception.config.persistence == Persistence(detection=0.3)
    with pytest.raises(ScenarioError, match=r"perception\.persistence\.detecton") as caught:
        load(LANE_CHANGE, ["perception.persistence.detecton=0.3"])
    assert "detection" in str(caught.value.problems)
