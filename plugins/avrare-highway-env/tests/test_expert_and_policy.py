"""The expert, the training script and the policy that is shipped."""

import numpy as np
import pytest
from highway_runs import simulator, tape

from avrare.driving import Vehicles
from avrare_highway_env.expert import Expert
from avrare_policy.controller import locate
from avrare_policy.network import load

SHIPPED = {"scene": "merge", "lidar": {"speeds": False}}


def vehicles(x, y, speed):
    x, y, speed = (np.atleast_1d(np.asarray(value, dtype=float)) for value in (x, y, speed))
    zero = np.zeros(np.broadcast_shapes(x.shape, y.shape, speed.shape))
    return Vehicles(x + zero, y + zero, zero, speed + zero, zero)


def expert(others, y=-4.0, speed=20.0):
    """Return throttle and steering of an ego at x = 100 among others (x, y, speed)."""
    table = np.array(others, dtype=float).reshape(-1, 3).T
    around = Vehicles(*(field[None] for field in vehicles(*table).__dict__.values()))
    return Expert().act(vehicles(100.0, y, speed), around)[0]


def test_the_expert_follows_and_keeps_its_lane():
    cases = ([], [(150, -4, 19), (150, 0, 19)], [(108, -4, 10), (108, 0, 10)])
    free, behind, close = (expert(others) for others in cases)
    assert free[0] > behind[0] > close[0]
    assert close[0] == -1.0
    assert free[1] == behind[1] == 0.0
    assert expert([], y=-3.5)[1] < 0.0 < expert([], y=-4.5)[1]


def test_the_expert_overtakes_where_there_is_room():
    slow = (130, -4, 12)
    assert expert([slow])[1] > 0.0
    assert expert([slow, (100, 0, 20)])[1] == 0.0
    assert expert([slow, (80, 0, 30)])[1] == 0.0
    assert expert([slow, (60, 0, 20)])[1] > 0.0


def test_the_shipped_policy_is_small_and_has_its_provenance():
    path = locate("merge_lidar")
    assert path.stat().st_size < 500_000
    network = load(path)
    assert network.weights[0].shape[0] == simulator(**SHIPPED).sensors.size
    assert {"source", "plan", "license"} <= network.provenance.keys()


def test_the_shipped_policy_passes_the_ramp():
    """Drive eight starts of the 320 of the model card."""
    sim, network = simulator(**SHIPPED), load(locate("merge_lidar"))
    noise = tape(sim, 8, 165, seed=77)
    world = sim.reset(noise[:, 0])
    for t in range(1, noise.shape[1]):
        world = sim.step(world, network(world.ego.observation), noise[:, t])
    assert world.arrived.all()


@pytest.mark.slow
def test_training_runs_and_is_reproducible(tmp_path):
    from avrare_highway_env.train import Plan, train

    plan = Plan(rounds=2, worlds=4, steps=12, epochs=2, hidden=8, batch=8)
    one, again = train(plan), train(plan)
    assert all(np.array_equal(a, b) for a, b in zip(one.weights, again.weights, strict=True))
    assert [weight.shape for weight in one.weights] == [(246, 8), (8, 8), (8, 2)]
    assert np.abs(one(np.zeros((3, 246)))).max() <= 1.0
