"""Reaction times of drivers: fixed, drawn and varying."""

import numpy as np
import pytest
from pydantic import TypeAdapter

from avrare.base.laws import Law
from avrare.driving import Action
from avrare_single_track.driver_model import idm
from drivers import car, drive, simulator


def test_a_driver_reacts_after_its_reaction_time():
    lead = car("lead", 40.0, brake=[{"from_step": 20, "to_step": 60, "acceleration": -4.0}], desired=20.0)
    begins = []
    for time in (0.0, 0.8):
        worlds = drive(simulator(lead, car("one", 0.0, desired=30.0, reaction_time=time)), 60)
        found = np.array([world.others.acceleration[0, 1] for world in worlds])
        assert np.abs(found[:20]).max() < 0.05  # the gap is the model's own
        begins.append(int(np.argmax(found < -0.1)))
    assert begins[1] - begins[0] == 8


def test_a_late_acceleration_is_the_prompt_one_of_that_time_ago():
    # at rest it does not move before it reacts, so that the model demands the same at every step until then
    sim = simulator(car("one", 0.0, speed=0.0, reaction_time=0.25), ego={"x": 500.0, "y": 1.75, "speed": 0.0})
    worlds = drive(sim, 12)
    speeds = np.array([world.others.speed[0, 0] for world in worlds])
    table = np.array([25.0, 1.5, 2.0, 1.5, 2.0, 8.0])
    gaps = 500.0 - np.array([world.others.x[0, 0] for world in worlds]) - 4.298
    wanted = np.array([idm(v, 0.0, gap, table) for v, gap in zip(speeds, gaps, strict=True)])
    found = np.array([world.others.acceleration[0, 0] for world in worlds])
    assert found[1:4] == pytest.approx(wanted[:1].repeat(3))  # before the start: as at the start
    expected = 0.5 * (wanted[1:10] + wanted[:9])  # 2.5 steps ago
    assert found[4:] == pytest.approx(expected, rel=1e-9)


def test_reaction_times_vary_about_their_median():
    sim = simulator(*[car(f"v{k}", 200.0 * k, reaction_time=1.0, reaction_sd=0.3) for k in range(3)],
                    car("prompt", 0.0, 5.25))  # fmt: skip
    assert sim.noise_names[4:] == tuple(f"reaction time of v{k}" for k in range(3))
    assert sim.noise_size == 7
    worlds = drive(sim, 20, n=800, seed=5)
    haste = np.array([world.drivers.haste for world in worlds])
    assert haste[[0, 10, 20]].std(axis=(1, 2)) == pytest.approx([0.3] * 3, abs=0.02)
    assert len(np.unique(worlds[-1].others.speed[:, 0])) > 780  # some are at the bound
    assert len(np.unique(worlds[-1].others.speed[:, 3])) == 1


TABLE = np.array([25.0, 1.5, 2.0, 1.5, 2.0, 8.0])


def _gap(acceleration):
    return 60.0 - 4.298 - 0.1 * (15.0 + 0.05 * acceleration)


def test_a_drawn_reaction_time_is_each_particle_s_own():
    ahead = {"name": "wall", "x": 60.0, "y": 1.75}
    sim = simulator(ahead, car("one", 0.0, speed=15.0))
    law = TypeAdapter(Law).validate_python({"law": "uniform", "low": 0.0, "high": 1.0})
    drawn = sim.drawing({"vehicles.1.driver.reaction_time": law})
    world = drawn.reset_drawn(np.zeros((2, 1)), {"vehicles.1.driver.reaction_time": np.array([0.0, 1.0])})
    found = []
    for _ in range(12):
        world = drawn.step(world, Action(np.zeros(2), np.zeros(2)), np.zeros((2, 1)))
        found.append(world.others.acceleration[:, 1])
    prompt, late = np.array(found).T
    assert prompt[1] != prompt[0]
    assert (late[:11] == prompt[0]).all()  # 1 s long as at the start
    assert late[11] == pytest.approx(idm(15.0 + 0.1 * prompt[0], 0.0, _gap(prompt[0]), TABLE), rel=1e-9)
