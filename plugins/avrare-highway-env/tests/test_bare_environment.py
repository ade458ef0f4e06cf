"""Against highway-env itself: the same starts, the same drives, the same lidar."""

import numpy as np
import pytest
from highway_env.envs.common.observation import LidarObservation
from highway_runs import simulator, steering

from avrare.driving.geometry import Rectangle
from avrare_highway_env import scenes
from avrare_highway_env.scenes import FlatLane
from avrare_highway_env.sensing import cast, closing, directions

SCENES = {"merge": {}, "highway": {"vehicles": 8}, "roundabout": {}}


def bare(sim, seed):
    """Return the environment as its users run it."""
    setting = scenes.setting_of(sim.config)
    own = {"simulation_frequency": 10, "policy_frequency": 10, "observation": {"type": "LidarObservation"}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenes, "flatten", lambda network: None)  # highway-env's own lanes
        environment = setting.environment({**setting.options, **own})
        environment.reset(seed=seed)
    return environment


def vehicles(environment):
    everything = environment.road.vehicles + environment.road.objects
    return [thing for thing in everything if thing is not environment.vehicle]


@pytest.mark.parametrize("seed", [3, 11])
@pytest.mark.parametrize("scene", SCENES)
def test_the_same_rollout_as_highway_env_bit_for_bit(scene, seed):
    sim = simulator(scene=scene, start_seed=seed, lidar={"cells": 8}, **SCENES[scene])
    environment = bare(sim, seed)
    assert sim.noise_size == 0
    kinds = [type(sim.environment.road.network.get_lane(("a", "b", 0)))] if scene == "merge" else []
    assert all(kind is FlatLane for kind in kinds)
    world, nothing = sim.reset(np.zeros((1, 0))), np.zeros((1, 0))
    for t in range(90):
        ego, others = environment.vehicle, vehicles(environment)
        assert world.crashed[0] == ego.crashed
        if world.over[0]:
            break
        assert [world.ego.x[0], -world.ego.y[0]] == ego.position.tolist()
        assert world.ego.speed[0] == ego.speed
        assert -world.ego.heading[0] == ego.heading
        assert world.others.x[0].tolist() == [other.position[0] for other in others]
        assert (-world.others.y[0]).tolist() == [other.position[1] for other in others]
        action = steering(t, 1)
        world = sim.step(world, action, nothing)
        environment.step(action[0] * (1.0, -1.0))
    assert t > 15


@pytest.mark.parametrize("seed", range(4))
def test_the_lidar(seed):
    """Compare all but the cell of an object's centre, which highway-env gives its half width, and corners."""
    sim = simulator(scene="highway", vehicles=12, start_seed=seed)
    environment = bare(sim, seed)
    environment.vehicle.heading = 0.05
    place = environment.vehicle.position[0]
    for vehicle in environment.road.vehicles:
        vehicle.position[0] = place + 0.35 * (vehicle.position[0] - place)
    observation = LidarObservation(environment, cells=240, maximum_range=60, normalize=False)
    theirs = observation.trace(environment.vehicle.position, environment.vehicle.velocity)
    ego, others = environment.vehicle, vehicles(environment)
    rows = [[*other.position, other.heading, other.speed] for other in others]
    x, y, heading, speed = (column[None] for column in np.array(rows).T)
    box = Rectangle(x, -y, -heading, np.full(len(others), 5.0), np.full(len(others), 2.0))
    rays = directions(240)
    ours, hit = cast(ego.position[:1], -ego.position[1:], box, rays, 60.0)
    along, across = speed * np.cos(heading), speed * np.sin(-heading)
    speeds = closing(along, across, ego.velocity[:1], -ego.velocity[1:], hit, rays)
    mirrored = theirs[-np.arange(240)]
    near = mirrored[:, 0] < 60.0
    assert near.sum() > 10
    differ = ~np.isclose(ours[0], mirrored[:, 0], atol=1e-3)
    assert differ.sum() <= len(others)
    agree = near & ~differ
    np.testing.assert_allclose(speeds[0][agree], mirrored[agree, 1], atol=1e-3)
    assert (speeds[0][hit[0] < 0] == 0.0).all()
    assert (ours[0][hit[0] < 0] == 60.0).all()
