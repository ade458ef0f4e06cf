"""Speeds at the roundabout: a limit of the lateral acceleration, or a warning that there is none."""

import numpy as np
import pytest
from pydantic import ValidationError

from avrare.driving import Action
from avrare_highway_env.config import HighwayEnvConfig
from avrare_highway_env.simulator import HighwayEnvSimulator


def lateral(limit):
    """Return the greatest lateral acceleration of drivers on the ring, and the greatest braking of any."""
    sim = HighwayEnvSimulator(HighwayEnvConfig(scene="roundabout", traffic={"bend_acceleration": limit}))
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


def test_other_scenes_have_no_ring():
    with pytest.raises(ValidationError, match=r"omit traffic\.bend_acceleration"):
        HighwayEnvConfig(scene="merge", traffic={"bend_acceleration": 3.0})
