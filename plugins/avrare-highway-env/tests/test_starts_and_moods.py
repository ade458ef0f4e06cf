"""Effects of the noise: starts, moods of the drivers, noise of the rays."""

import numpy as np
import pytest
from highway_runs import run, same, simulator, tape
from pydantic import ValidationError

from avrare_highway_env.config import HighwayEnvConfig
from avrare_highway_env.sensing import FEATURES


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
    quiet, moody = (
        simulator(scene="merge", start_seed=1, traffic={"acceleration_sd": sd}) for sd in (0.0, 2.0)
    )
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
    moods = np.array(
        [
            [[thing[1].get("mood", 0.0) for thing in snapshot.objects[1:5]] for snapshot in world.snapshot]
            for world in worlds[20:]
        ]
    )
    assert moods.std() == pytest.approx(1.5, rel=0.1)
    kept = (moods[1:] * moods[:-1]).mean() / (moods**2).mean()
    assert kept == pytest.approx(np.exp(-0.1 / 0.5), abs=0.05)
    assert abs(moods.mean()) < 0.25


def test_the_noise_of_the_rays():
    config = {"cells": 240, "noise_variance": 0.004}
    clean = simulator(scene="merge", start_seed=1, lidar={"cells": 240})
    noisy = simulator(scene="merge", start_seed=1, lidar=config)
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
