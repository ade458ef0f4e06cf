"""Errors common to all detections, of the ego's pose, blackouts, and weather over range and ghosts."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from avrare.base import batch
from avrare_gp_pem.config import ParametricPemConfig
from avrare_gp_pem.runtime.models import build_parametric
from avrare_gp_pem.runtime.shared_errors import SharedErrorPem

PLACES = [[10.0, 1.0, 0.1], [25.0, -3.0, 0.0]]
SEEN = {"speed_sd": 0.0, "error_scale": 1e-9}


def parametric(scene, **options):
    return build_parametric(ParametricPemConfig(**options), scene)


def follow(model, world, steps, seed=0):
    """Return the observations of ``steps`` steps in one world, all vehicles detected, and the memories."""
    rng = np.random.default_rng(seed)

    def draw():
        noise = rng.standard_normal((len(world.ego.x), model.noise_size))
        noise[:, [k for k, name in enumerate(model.noise_names) if "detection" in name]] = -8.0
        return noise

    memory, seen, memories = model.start(draw()), [], []
    for _ in range(steps):
        observation, memory = model.follow(world, draw(), memory)
        seen.append(observation)
        memories.append(memory)
    return seen, memories


def test_nothing_is_added_without_the_options(build, make):
    model = build(make.scene(2))
    assert model.noise_size == 8
    assert not isinstance(model, SharedErrorPem)


def test_other_noise_keeps_its_place(build, make):
    exact = {"sd": (0.0, 0.0)}
    plain, more = build(make.scene(2)), build(make.scene(2), common=exact, pose=exact)
    assert more.noise_names[:8] == plain.noise_names
    assert more.noise_size == len(more.noise_names) == len(more.perfect_noise) == 8 + 2 + 3
    world, noise = make.random(30, 2), np.random.default_rng(1).standard_normal((30, 13))
    seen, _ = more.follow(world, noise, more.start(noise))
    expected = plain.observe(world, noise[:, :8])
    np.testing.assert_array_equal(seen.detected, expected.detected)
    np.testing.assert_allclose(seen.x, expected.x, atol=1e-12)


@pytest.mark.parametrize("time", [None, 0.5])
def test_a_common_error_is_that_of_all_and_lasts(make, time):
    model = parametric(make.scene(2), common={"sd": (0.3, 0.1), "time": time}, **SEEN)
    world = make.world(PLACES, n=4000)
    seen, _ = follow(model, world, 6)
    errors = np.array([[one.x - world.others.x, one.y - world.others.y] for one in seen])
    np.testing.assert_allclose(errors[..., 0], errors[..., 1], atol=1e-6)  # of both vehicles
    for axis, sd in ((0, 0.3), (1, 0.1)):
        assert errors[5, axis, :, 0].std() == pytest.approx(sd, rel=0.05)
        correlation = np.corrcoef(errors[0, axis, :, 0], errors[5, axis, :, 0])[0, 1]
        assert correlation == pytest.approx(1.0 if time is None else math.exp(-1.0), abs=0.05)


def test_an_error_of_the_pose_moves_the_ego_and_all_it_sees(make):
    model = parametric(make.scene(2), pose={"sd": (0.5, 0.2), "heading_sd": 0.02}, **SEEN)
    world = make.world(PLACES, ego=(3.0, 0.5, 0.3), n=500)
    seen, memories = follow(model, world, 2)
    believed = model.locate(world.ego, memories[-1])
    assert (believed.y - world.ego.y).std() == pytest.approx(0.2, rel=0.15)
    turn = believed.heading - world.ego.heading
    assert turn.std() == pytest.approx(0.02, rel=0.15)

    def relative(x, y, ego):  # what the sensor has measured, whatever the ego believes
        dx, dy = x - ego.x[:, None], y - ego.y[:, None]
        cos, sin = np.cos(ego.heading)[:, None], np.sin(ego.heading)[:, None]
        return cos * dx + sin * dy, cos * dy - sin * dx

    truth = relative(world.others.x, world.others.y, world.ego)
    np.testing.assert_allclose(relative(seen[-1].x, seen[-1].y, believed), truth, atol=1e-6)


def test_blackouts_are_as_frequent_and_long_as_they_should_be(make):
    rate, duration, n = 0.5, 0.4, 300
    model = parametric(make.scene(2), blackouts={"rate": rate, "duration": duration}, ghosts={"rate": 0.5})
    world = make.world(PLACES, n=n)
    seen, memories = follow(model, world, 200)
    dark = np.array([memory.dark for memory in memories])
    assert not np.array([one.detected for one in seen])[dark].any()
    assert np.isnan(np.array([one.x for one in seen])[dark]).all()
    begun = (dark[1:] & ~dark[:-1]).sum() / (~dark[:-1]).sum()
    ended = (~dark[1:] & dark[:-1]).sum() / dark[:-1].sum()
    assert begun == pytest.approx(1.0 - math.exp(-0.1 * rate), rel=0.1)
    assert ended == pytest.approx(1.0 - math.exp(-0.1 / duration), rel=0.1)


def test_a_batch_has_the_rows_of_its_parts(make):
    options = {"common": {"sd": (0.3, 0.1), "time": 1.0}, "pose": {"sd": (0.1, 0.1)}}
    options |= {"blackouts": {"rate": 1.0, "duration": 0.3}, "persistence": {"position": 1.0}}
    model = parametric(make.scene(2), **options)
    noise = np.random.default_rng(4).standard_normal((6, 8, model.noise_size))
    world, rows = make.random(8, 2), np.array([5, 2])
    memory, part = model.start(noise[0]), model.start(noise[0, rows])
    for row in noise[1:]:
        seen, memory = model.follow(world, row, memory)
        other, part = model.follow(batch.take(world, rows), row[rows], part)
        for leaf, expected in zip(batch.leaves(other), batch.leaves(batch.take(seen, rows)), strict=True):
            np.testing.assert_array_equal(leaf, expected)


def test_weather_shortens_the_range(make):
    model = parametric(make.scene(1), weather_range=1.0, detection_range=60.0)
    world = make.world([[30.0, 0.0, 0.0]], n=2)
    wet = replace(world, weather=np.array([1.0, 2.0]))
    clear, half = model.law(wet).detect[:, 0]
    assert half == pytest.approx(0.986 / 2.0)  # at half the range, which is where the logistic has its middle
    assert clear > 0.9
    assert model.law(world).detect[1, 0] == clear


def test_weather_adds_ghosts(make):
    model = parametric(make.scene(1), ghosts={"rate": 0.2, "slots": 4, "weather": 1.0})
    counts = {}
    for weather in (1.0, 3.0):
        world = replace(make.world([[10.0, 0.0, 0.0]], n=4000), weather=np.full(4000, weather))
        seen, _ = follow(model, world, 2)
        counts[weather] = seen[-1].detected[:, 1:].sum(axis=1).mean()
    assert counts[1.0] == pytest.approx(0.2, rel=0.1)
    assert counts[3.0] == pytest.approx(0.6, rel=0.1)


def test_a_world_without_weather_is_in_clear_weather(make):
    ghosts = {"rate": 0.2, "slots": 4, "weather": 1.0}
    model, plain = (parametric(make.scene(1), weather_range=1.0, **more) for more in ({"ghosts": ghosts}, {}))
    world = make.world([[10.0, 0.0, 0.0]], n=40)
    other = SimpleNamespace(**{name: value for name, value in vars(world).items() if name != "weather"})
    (seen, _), (same, _) = follow(model, world, 2), follow(model, other, 2)
    np.testing.assert_array_equal(same[-1].x, seen[-1].x)
    noise = np.zeros((40, plain.noise_size))
    ratio, _ = plain.log_ratio(other, noise, None, parametric(make.scene(1), error_scale=2.0), None)
    assert np.isfinite(ratio).all()
