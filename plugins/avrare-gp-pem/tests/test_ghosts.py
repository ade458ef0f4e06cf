"""False detections: their number, places and times, and what a stack may do with them."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from avrare.base.errors import UsageError
from avrare_gp_pem.config import Ghosts, GpPemConfig, NaivePemConfig, ParametricPemConfig
from avrare_gp_pem.runtime.ghosts import NOISE_PER_GHOST, with_ghosts
from avrare_gp_pem.runtime.models import build_gp, build_naive, build_parametric
from avrare_gp_pem.runtime.variant import MeasuredGhosts
from perception_scenes import follow

SHARED = {"rate": 0.6, "persistence": 0.4, "slots": 2, "forward": (10.0, 30.0), "left": (-4.0, 4.0)}


@pytest.fixture
def model(make):
    return build_parametric(ParametricPemConfig(ghosts=SHARED), make.scene(2))


def test_vehicles_are_seen_as_without_ghosts(build, make):
    scene, world = make.scene(3), make.random(40, 3)
    plain, haunted = build(scene), build(scene, ghosts=SHARED)
    noise = np.random.default_rng(0).standard_normal((40, haunted.noise_size))
    assert haunted.noise_size == plain.noise_size + 2 * NOISE_PER_GHOST == len(haunted.noise_names)
    one, other = plain.observe(world, noise[:, : plain.noise_size]), haunted.observe(world, noise)
    for name in ("detected", "x", "y", "speed_x"):
        np.testing.assert_array_equal(getattr(other, name)[:, :3], getattr(one, name))
        assert getattr(other, name).shape == (40, 5)
    assert type(build(scene, ghosts=None)) is type(plain)


@pytest.mark.parametrize("persistence", [0.0, 0.4])
def test_their_mean_number_is_the_rate_at_every_step(make, persistence):
    options = SHARED | {"persistence": persistence}
    model = build_parametric(ParametricPemConfig(ghosts=options), make.scene(1))
    world = make.world([[20.0, 0.0, 0.0]], n=6000)
    _, seen, _ = follow(model, world, 4)
    for one in seen:  # 12,000 slots, each with a ghost with probability 0.3
        assert one.detected[:, 1:].sum(axis=1).mean() == pytest.approx(0.6, abs=4 * math.sqrt(0.42 / 6000))


def test_they_last_as_long_as_they_should(make, model):
    world = make.world([[20.0, 0.0, 0.0], [30.0, 3.0, 0.0]], n=4000)
    _, _seen, memories = follow(model, world, 6)
    before, after = memories[2], memories[3]
    same = before.present & after.present & (before.forward == after.forward)
    share = same.sum() / before.present.sum()
    assert share == pytest.approx(math.exp(-0.1 / 0.4), abs=4 * math.sqrt(0.2 / before.present.sum()))


def test_their_places_are_uniform_where_they_may_be(make, model):
    world = make.world([[20.0, 0.0, 0.0], [30.0, 3.0, 0.0]], ego=(100.0, 5.0, np.pi / 2), n=4000)
    _, seen, memories = follow(model, world, 1)
    x, y = (part[:, 2:][seen[0].detected[:, 2:]] for part in (seen[0].x, seen[0].y))
    forward, left = y - 5.0, 100.0 - x  # the ego looks along y
    exact = memories[0].present
    assert memories[0].forward[exact].min() >= 10.0
    assert memories[0].forward[exact].max() <= 30.0
    assert forward.mean() == pytest.approx(20.0, abs=4 * 5.8 / math.sqrt(len(x)))
    assert left.std() == pytest.approx(8 / math.sqrt(12), rel=0.05)


@pytest.mark.parametrize("motion", ["road", "ego"])
def test_they_stand_on_the_road_or_move_with_the_ego(make, motion):
    options = SHARED | {"persistence": 1e6, "motion": motion, "sd": 0.0}
    model = build_parametric(ParametricPemConfig(ghosts=options, speed_sd=0.0), make.scene(1))
    memory = model.start(np.random.default_rng(1).standard_normal((50, model.noise_size)))
    zero = np.zeros((50, model.noise_size))
    first, memory = model.follow(make.world([[50.0, 0.0, 0.0]], n=50), zero, memory)
    moved = make.world([[50.0, 0.0, 0.0]], ego=(7.0, 0.0, 0.0), n=50)
    second, _ = model.follow(moved, zero, memory)
    there = first.detected[:, 1:]
    assert there.any()
    np.testing.assert_array_equal(second.detected[:, 1:], there)
    shift = (second.x - first.x)[:, 1:][there]
    np.testing.assert_allclose(shift, 7.0 if motion == "ego" else 0.0, atol=1e-12)
    np.testing.assert_allclose(second.speed_x[:, 1:][there], 10.0 if motion == "ego" else 0.0, atol=1e-12)


@pytest.mark.parametrize("motion", ["road", "ego"])
def test_those_near_vehicles_are_around_them(make, motion):
    options = SHARED | {"near": 0.5, "near_sd": (3.0, 1.0), "sd": 0.0, "motion": motion}
    model = build_parametric(ParametricPemConfig(ghosts=options), make.scene(2))
    cars = [[200.0, 50.0, np.pi / 2], [300.0, -40.0, 0.0]]
    world = make.world(cars, ego=(100.0, 0.0, 0.3), n=4000)
    _, seen, memories = follow(model, world, 2)
    for one, memory in zip(seen, memories, strict=True):
        x, y = (part[:, 2:][memory.present] for part in (one.x, one.y))
        first, second = (np.hypot(x - cx, y - cy) < 20.0 for cx, cy, _ in cars)
        for near in (first, second):
            assert near.mean() == pytest.approx(0.25, abs=4 * math.sqrt(0.19 / len(x)))
        elsewhere = ~first & ~second
        assert (np.hypot(x[elsewhere] - 100.0, y[elsewhere]) < 31.0).all()
        few = 4 / math.sqrt(2 * first.sum())
        assert (y[first] - 50.0).std() == pytest.approx(3.0, rel=few)  # this car looks along y
        assert (x[first] - 200.0).std() == pytest.approx(1.0, rel=few)
        assert (x[second] - 300.0).std() == pytest.approx(3.0, rel=few)


@pytest.mark.parametrize("options", [{"ghosts": SHARED}, {"ghosts": SHARED, "speed_y_sd": 0.1}])
def test_the_naive_model_has_no_ratio(make, options):
    model = build_naive(NaivePemConfig(**options), make.scene(1))
    noise = np.zeros((1, model.noise_size))
    memory = model.start(noise)
    with pytest.raises(UsageError, match="NaivePem has no density ratio"):
        model.log_ratio(make.random(1, 1), noise, memory, model, memory)


def test_places_of_data_are_drawn_around_them(make):
    points = np.array([[10.0, 2.0], [40.0, -6.0]])
    law = MeasuredGhosts(rate=1.0, persistence=0.0, points=points, width=0.5)
    plain = build_parametric(ParametricPemConfig(), make.scene(0))
    model = with_ghosts(plain, law, make.scene(0), 0.3)
    world = make.world(np.zeros((0, 3)), n=3000)
    _, _, memories = follow(model, world, 1)
    present = memories[0].present
    place = np.stack([memories[0].forward[present], memories[0].left[present]], axis=-1)
    nearest = np.abs(place[:, None] - points).sum(axis=2).argmin(axis=1)
    assert nearest.mean() == pytest.approx(0.5, abs=0.05)
    np.testing.assert_allclose((place - points[nearest]).std(axis=0), 0.5, rtol=0.06)
    assert law.slots == model.ghost_slots == 4


def test_perfect_noise_has_none(make, model):
    world = make.world([[20.0, 0.0, 0.0], [30.0, 3.0, 0.0]])
    perfect = np.array([model.perfect_noise])
    memory = model.start(perfect)
    for _ in range(3):
        observation, memory = model.follow(world, perfect, memory)
        assert observation.detected.tolist() == [[True, True, False, False]]


@pytest.mark.parametrize("changed", [{"rate": 0.66}, {"persistence": 0.5}, {"rate": 0.5, "persistence": 0.3}])
@pytest.mark.parametrize("lasting", [{}, {"detection": 0.4}])
def test_the_density_ratio_has_mean_one_and_gives_the_other_law(make, changed, lasting):
    world, n = make.world([[20.0, 0.0, 0.0]], n=20_000), 20_000
    configs = (ParametricPemConfig(ghosts=SHARED | part, persistence=lasting) for part in ({}, changed))
    models = [build_parametric(config, make.scene(1)) for config in configs]
    noise = np.random.default_rng(5).standard_normal((4, n, models[0].noise_size))
    memory, other_memory = (model.start(noise[0]) for model in models)
    total, seen = np.zeros(n), None
    for row in noise[1:]:
        ratio, other_memory = models[0].log_ratio(world, row, memory, models[1], other_memory)
        seen, memory = models[0].follow(world, row, memory)
        total += ratio
    weight = np.exp(total)
    assert weight.mean() == pytest.approx(1.0, abs=4 * weight.std() / math.sqrt(n))
    count = weight * seen.detected[:, 1:].sum(axis=1)
    assert count.mean() == pytest.approx(models[1].ghosts.rate, abs=4 * count.std() / math.sqrt(n))


def test_ghosts_that_last_have_no_ratio_under_ghosts_that_never_do(make):
    configs = (ParametricPemConfig(ghosts={"rate": 0.3, "persistence": time}) for time in (0.0, 0.5))
    fresh, lasting = (build_parametric(config, make.scene(1)) for config in configs)
    world = make.world([[20.0, 0.0, 0.0]], n=50)
    noise = np.random.default_rng(3).standard_normal((2, 50, fresh.noise_size))
    for own, other, known in ((fresh, lasting, False), (lasting, fresh, True)):
        ratio, _ = own.log_ratio(world, noise[1], own.start(noise[0]), other, other.start(noise[0]))
        assert (~np.isnan(ratio)).all() if known else np.isnan(ratio).all()


def test_other_options_of_ghosts_have_no_ratio(make, model):
    other = build_parametric(ParametricPemConfig(ghosts=SHARED | {"sd": 0.5}), make.scene(2))
    noise = np.zeros((1, model.noise_size))
    memory = model.start(noise)
    with pytest.raises(UsageError, match="vary rate and persistence only"):
        model.log_ratio(make.random(1, 2), noise, memory, other, memory)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rate": 2.0, "slots": 3}, "need 4 slots"),
        ({"rate": 0.0}, "greater than 0"),
        ({"rate": 0.1, "forward": (5.0, 5.0)}, "forward: 5 is not below 5"),
        ({"rate": 0.1, "persistence": -1.0}, "greater than or equal to 0"),
        ({}, "rate"),
    ],
)
def test_options_that_cannot_be_are_refused(options, message):
    with pytest.raises(ValidationError, match=message):
        Ghosts(**options)


def test_a_model_without_ghosts_in_its_data_says_so(make):
    with pytest.raises(UsageError, match="has no measured ghosts"):
        build_gp(GpPemConfig(model="best", ghosts="measured"), make.scene(1))
