"""Speeds in bends of roundabout and intersection: a limit of the acceleration, or a warning of its lack."""

import numpy as np
from highway_runs import simulator

from avrare.driving import Action


def lateral(limit):
    """Return the greatest lateral acceleration of drivers on the ring, and the greatest braking of any."""
    sim = simulator(scene="roundabout", traffic={"bend_acceleration": limit})
    rng = np.random.default_rng(2)
    world, across, braking = sim.reset(rng.standard_normal((3, sim.noise_size))), 0.0, 0.0
    for _ in range(60):
        still = Action(np.full(3, -3.0), np.zeros(3))  # the ego waits before the ring
        world = sim.step(world, still, rng.standard_normal((3, sim.noise_size)))
        others = world.others
        radius = np.hypot(others.x, others.y)
        ring = (radius > 18.0) & (radius < 26.0)
        across = max(across, (others.speed**2 / radius)[ring].max(initial=0.0))
        braking = max(braking, -others.acceleration.min())
    return sim, across, braking


def test_a_limit_bounds_the_speeds_on_the_ring():
    sim, across, braking = lateral(3.0)
    assert 2.0 < across < 4.6  # the speeds of the start are spread by an eighth
    assert braking < 8.0
    assert sim.warnings == {}


def test_without_a_limit_the_drivers_are_those_of_highway_env_and_a_warning_says_so():
    sim, across, _ = lateral(None)
    assert across > 9.81
    assert "traffic.bend_acceleration" in sim.warnings["beyond_tyres"]


def turning(limit):
    """Return the lateral accelerations of those who turn at the intersection while the ego waits."""
    options = {"bend_acceleration": limit, "acceleration_sd": 1.0}
    sim = simulator(scene="intersection", vehicles=6, traffic=options)
    rng = np.random.default_rng(2)
    world, across = sim.reset(rng.standard_normal((4, sim.noise_size))), []
    for _ in range(100):
        before = world.others
        waiting = np.stack([np.where(world.ego.speed > 0.5, -0.6, 0.0), np.zeros(4)], axis=1)
        world = sim.step(world, waiting, rng.standard_normal((4, sim.noise_size)))
        turned = np.remainder(world.others.heading - before.heading + np.pi, 2.0 * np.pi) - np.pi
        same = np.hypot(world.others.x - before.x, world.others.y - before.y) < 2.0
        across.append(np.abs(world.others.speed * turned / 0.1)[same])
    return sim, np.concatenate(across)


def test_a_limit_bounds_the_speeds_of_turns_at_the_intersection():
    sim, across = turning(3.0)
    assert 1.5 < np.quantile(across, 0.99) < 3.5
    assert across.max() < 7.0
    assert sim.warnings == {}
    free, across = turning(None)
    assert across.max() > 9.81
    assert "radius of 9 m" in free.warnings["beyond_tyres"]
