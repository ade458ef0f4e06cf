"""Drawn options: every rollout has drivers and an ego's start of its own, copies and rows included."""

import numpy as np
import pytest
from highway_runs import OPTIONS, run, same, simulator, tape

from avrare.base import batch

VALUES = {
    "traffic.desired_speed": (20.0, 26.0, 32.0),
    "traffic.time_gap": (0.8, 1.5, 2.5),
    "traffic.acceleration_sd": (0.2, 1.0, 2.0),
    "ego_speed": (22.0, 25.0, 28.0),
}


def values(*rows):
    return {name: np.array(own)[list(rows)] for name, own in VALUES.items()}


@pytest.mark.parametrize("scene", ["merge", "intersection"])
def test_rows_have_their_own_values_alone_and_together(scene):
    options = {**OPTIONS[scene], "traffic": {"acceleration_sd": 1.0}}
    sim = simulator(**options)
    noise = np.repeat(tape(sim, 1, 12), 3, axis=0)
    start = sim.reset_drawn(noise[:, 0], values(0, 1, 2))
    assert start.ego.speed.tolist() == [22.0, 25.0, 28.0]
    together = sim.step(start, np.zeros((3, 2)), noise[:, 1])
    assert len(set(together.others.speed[:, 0].tolist())) == 3
    for row in range(3):
        alone = sim.step(
            sim.reset_drawn(noise[row : row + 1, 0], values(row)), np.zeros((1, 2)), noise[row : row + 1, 1]
        )
        assert same(alone, batch.take(together, [row]))
        fixed = simulator(
            **{
                **options,
                "ego_speed": VALUES["ego_speed"][row],
                "traffic": {
                    name.removeprefix("traffic."): own[row] for name, own in VALUES.items() if "." in name
                },
            }
        )
        again = fixed.step(fixed.reset(noise[row : row + 1, 0]), np.zeros((1, 2)), noise[row : row + 1, 1])
        assert same(again, alone)


def test_drivers_reach_the_speed_that_they_desire():
    sim = simulator(scene="highway", vehicles=2, traffic={"desired_speed": 18.0}, start_seed=3)
    world = run(sim, tape(sim, 1, 60), lambda t, n: np.zeros((n, 2)))[-1]
    np.testing.assert_allclose(world.others.speed, 18.0, atol=1.0)
