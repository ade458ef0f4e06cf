"""Effects of the noise: random numbers from the tape, starts, moods of the drivers, noise of the rays."""

import numpy as np
import pytest
from highway_runs import run, same, simulator, tape
from pydantic import ValidationError

from avrare_highway_env.config import HighwayEnvConfig
from avrare_highway_env.sensing import FEATURES
from avrare_highway_env.tape import TapeRandom


def idle(t, n):
    return np.zeros((n, 2))


def test_starts_come_from_the_tape():
    sim = simulator(scene="merge")
    world = sim.reset(tape(sim, 200, 0)[:, 0])
    first = world.others.x[:, 0]
    assert ((first >= 85.0) & (first <= 95.0)).all()
    assert first.std() == pytest.approx(10.0 / np.sqrt(12.0), rel=0.15)
    assert ((world.others.speed[:, 0] >= 28.0) & (world.others.speed[:, 0] <= 30.0)).all()
    left = (world.others.y[:, 0] == 0.0).mean()
    assert 0.35 < left < 0.65
    assert (world.ego.x == 30.0).all()
    assert sim.scene.names[-1] == "obstacle_4"
    assert sim.scene.moving.tolist() == [True] * 4 + [False]


def test_a_fixed_start_needs_no_noise():
    sim = simulator(scene="merge", start_seed=4)
    assert sim.noise_size == 0
    world = sim.reset(np.zeros((3, 0)))
    assert (world.others.x == world.others.x[0]).all()
    other = simulator(scene="merge", start_seed=5).reset(np.zeros((1, 0)))
    assert not same(world, other)


def test_without_moods_drivers_are_those_of_highway_env():
    moods = ({"acceleration_sd": sd} for sd in (0.0, 2.0))
    quiet, moody = (simulator(scene="merge", start_seed=1, traffic=traffic) for traffic in moods)
    assert (quiet.noise_size, moody.noise_size) == (0, 5)
    calm = run(moody, np.zeros((1, 41, 5)), idle)[-1]
    assert same(run(quiet, np.zeros((1, 41, 0)), idle)[-1], calm)
    stirred = run(moody, tape(moody, 1, 40), idle)[-1]
    assert not np.allclose(stirred.others.x, calm.others.x)


@pytest.mark.parametrize("scene", ["highway", "intersection"])
def test_drivers_stop_and_do_not_reverse(scene):
    sim = simulator(scene=scene, traffic={"acceleration_sd": 1.0, "desired_speed": 0.01})
    worlds = run(sim, tape(sim, 3, 60), idle)
    speeds = np.concatenate([world.others.speed.ravel() for world in worlds])
    assert np.isfinite(speeds).all()
    assert speeds.min() == 0.0
    assert speeds.max() > 5.0


@pytest.mark.slow
def test_moods_are_an_ornstein_uhlenbeck_process():
    options = {"acceleration_sd": 1.5, "correlation_time": 0.5}
    sim = simulator(scene="merge", start_seed=1, traffic=options)
    noise = tape(sim, 60, 40)
    worlds = run(sim, noise, lambda t, n: np.full((n, 2), -0.01))
    cars = [[snapshot.objects[1:5] for snapshot in world.snapshot] for world in worlds[20:]]
    moods = np.array([[[car[1].get("mood", 0.0) for car in row] for row in rows] for rows in cars])
    assert moods.std() == pytest.approx(1.5, rel=0.1)
    kept = (moods[1:] * moods[:-1]).mean() / (moods**2).mean()
    assert kept == pytest.approx(np.exp(-0.1 / 0.5), abs=0.05)
    assert abs(moods.mean()) < 0.25


def test_the_noise_of_the_rays():
    configs = ({"cells": 240, "noise_variance": variance} for variance in (0.0, 0.004))
    clean, noisy = (simulator(scene="merge", start_seed=1, lidar=config) for config in configs)
    assert (clean.noise_size, noisy.noise_size) == (0, 240)
    numbers = tape(noisy, 100, 0)[:, 0]
    true = clean.reset(np.zeros((1, 0))).ego.observation[0]
    seen = noisy.reset(numbers).ego.observation
    rays = slice(FEATURES, FEATURES + 240)
    expected = np.clip(true[rays] + np.sqrt(0.004) * numbers, 0.0, 1.0)
    assert np.array_equal(seen[:, rays], expected)
    beside = np.r_[0:FEATURES, FEATURES + 240 : true.size]
    assert np.array_equal(seen[:, beside], np.tile(true[beside], (100, 1)))
    assert (true[rays] < 1.0).any()


def test_the_noise_changes_observations_and_not_the_world():
    sim = simulator(scene="merge", start_seed=1, lidar={"noise_variance": 0.004})
    one, other = (run(sim, tape(sim, 1, 10, seed), idle)[-1] for seed in (1, 2))
    assert np.array_equal(one.others.x, other.others.x)
    assert not np.array_equal(one.ego.observation, other.ego.observation)


@pytest.mark.parametrize(
    "options",
    [
        {"scene": "merge", "vehicles": 3},
        {"scene": "roundabout", "goal": 100.0},
        {"scene": "intersection", "dt": 1.0},
        {"scene": "racetrack"},
        {"dt": 0.0},
        {"lidar": {"cells": 0}},
        {"lidar": {"noise_variance": -1.0}},
        {"traffic": {"speed": 1.0}},
    ],
)
def test_invalid_options_are_refused(options):
    with pytest.raises(ValidationError):
        HighwayEnvConfig.model_validate(options)


def numbers(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def test_every_draw_uses_the_next_number():
    tape = TapeRandom(np.array([0.0, 0.0, 1.5, 0.0, -9.0, 9.0]))
    assert tape.random() == 0.5
    assert tape.uniform(-5.0, 5.0) == 0.0
    assert tape.normal(2.0, 2.0) == 5.0
    assert tape.integers(3) == 1
    assert tape.integers(2, 5) == 2
    assert tape.integers(2, 5) == 4
    assert tape.used == 6


def test_draws_have_the_laws_of_their_names():
    tape = TapeRandom(numbers(20_000))
    uniform = np.array([tape.uniform(2.0, 4.0) for _ in range(10_000)])
    assert uniform.mean() == pytest.approx(3.0, abs=0.02)
    assert uniform.var() == pytest.approx(4 / 12, abs=0.01)
    counts = np.bincount([tape.integers(4) for _ in range(10_000)], minlength=4)
    assert np.abs(counts - 2500).max() < 200


def test_choices_with_and_without_replacement():
    tape = TapeRandom(numbers(4000))
    names = [tape.choice(["a", "b", "c"]) for _ in range(900)]
    assert all(200 < names.count(name) < 400 for name in "abc")
    assert 0 <= tape.choice(np.int64(3)) < 3
    pairs = [tape.choice(range(4), size=2, replace=False) for _ in range(500)]
    assert all(a != b for a, b in pairs)
    assert len({(int(a), int(b)) for a, b in pairs}) == 12
    doubles = [tape.choice(2, size=2) for _ in range(100)]
    assert any(a == b for a, b in doubles)


def test_beyond_its_end_the_tape_seeds_the_draws():
    def draws(tape):
        return [tape.normal() for _ in range(10)]

    one, again, other = (draws(TapeRandom(numbers(3, seed))) for seed in (1, 1, 2))
    assert one == again
    assert len(set(one)) == 10
    assert set(one).isdisjoint(other)
    assert draws(TapeRandom(np.zeros(0))) == draws(TapeRandom(np.zeros(0)))
    tail = draws(TapeRandom(np.nextafter(numbers(3, 1), 9.0)))[3:]
    assert set(tail).isdisjoint(one)
