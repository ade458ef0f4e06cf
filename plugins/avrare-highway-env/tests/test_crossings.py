"""The scenarios `roundabout` and `intersection`: noise alone decides their runs, which end as they should."""

from pathlib import Path

import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle
from highway_runs import numbers, simulator, tape

import avrare
from avrare_highway_env.drivers import LightEgo

SCENARIOS = Path(__file__).parents[3] / "scenarios"


@pytest.fixture(scope="module", params=["roundabout", "intersection"])
def scenario(request):
    return avrare.load(SCENARIOS / f"{request.param}.yaml")


@pytest.fixture(scope="module")
def loop(scenario):
    return scenario.stack.loop


def drive(loop, noise, state=None, start=0):
    states = [loop.initial(noise[:, 0]) if state is None else state]
    for t in range(start + 1, noise.shape[1]):
        states.append(loop.step(states[-1], noise[:, t]))
    return states


def same(a, b):
    return all(np.array_equal(p, q) for p, q in zip(numbers(a.world), numbers(b.world), strict=True))


def test_a_restored_state_continues_identically(loop):
    noise = tape(loop, 2, 40)
    states = drive(loop, noise)
    again = drive(loop, noise, states[15], 15)
    assert all(same(a, b) for a, b in zip(states[15:], again, strict=True))


def test_without_noise_the_ego_arrives(scenario, loop):
    """Drive among drivers without moods, from the middle of every start; the specification agrees."""
    noise = np.zeros((1, scenario.steps + 1, loop.noise_size))
    last = drive(loop, noise)[-1]
    signals = loop.signals(last)
    assert signals["arrived"] == 1.0
    assert signals["crashed"] == 0.0
    assert signals["y"] > 30.0
    assert scenario.problem("passes").robustness(noise) > 0.0


def test_the_roundabout_is_over_only_on_a_road_that_leaves():
    sim = simulator(scene="roundabout", start_seed=1)
    world = sim.reset(np.zeros((1, 0)))
    assert not world.arrived[0]
    road = sim.environment.road.network
    for name in ("exr", "sxr", "nxr", "wxr"):
        lane = road.get_lane((name[:-1] + "s", name, 0))
        sim.environment.vehicle.position = lane.position(5.0, 0.0)
        sim.environment.vehicle.heading = lane.heading_at(5.0)
        sim.environment.vehicle.on_state_update()
        assert sim.environment.has_arrived(sim.environment.vehicle)


def test_the_light_ego_predicts_the_trajectory_of_highway_env():
    sim = simulator(scene="intersection", start_seed=2)
    sim.step(sim.reset(np.zeros((1, 6))), np.array([[0.4, 0.2]]), np.zeros((1, 6)))
    ego = sim.environment.vehicle
    assert type(ego) is LightEgo
    assert ego.action["steering"] != 0.0
    times = np.arange(0.25, 3.0, 0.25)
    before = ego.position.copy()
    places, headings = ego.predict_trajectory_constant_speed(times)
    expected, turned = Vehicle.predict_trajectory_constant_speed(ego, times)
    assert np.array_equal(places, expected)
    assert headings == turned
    assert np.array_equal(ego.position, before)
