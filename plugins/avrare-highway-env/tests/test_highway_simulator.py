"""The simulator as a whole: what its worlds do, that they depend on their noise alone, and drawn options."""

import highway_runs as runs
import numpy as np
import pytest
from highway_runs import OPTIONS, numbers, run, same, simulator, steering, tape

from avrare.base import batch
from avrare.base.batch import concatenate, take
from avrare.base.errors import UsageError
from avrare.driving import Action
from avrare_highway_env.worlds import ABSENT


@pytest.fixture(scope="module", params=list(runs.OPTIONS))
def sim(request):
    return simulator(**runs.OPTIONS[request.param])


def test_a_restored_state_continues_identically(sim):
    noise = tape(sim, 3, 40)
    worlds = run(sim, noise)
    before = [leaf.copy() for leaf in numbers(worlds[15])]
    again = run(sim, noise, world=worlds[15], start=15)
    assert all(np.array_equal(a, b) for a, b in zip(before, numbers(worlds[15]), strict=True))
    assert all(same(a, b) for a, b in zip(worlds[15:], again, strict=True))


def test_copies_diverge_only_by_their_noise(sim):
    noise = tape(sim, 1, 30)
    worlds = run(sim, noise)
    twins = concatenate([worlds[10], worlds[10]])
    fresh = np.concatenate([noise, tape(sim, 1, 30, seed=5)])
    late = run(sim, fresh, lambda t, n: np.repeat(steering(t, 1), n, axis=0), twins, 10)[-1]
    assert same(take(late, slice(0, 1)), worlds[-1])


def test_worlds_that_are_over_stand_still():
    sim = simulator(scene="merge", goal=60.0, traffic={"acceleration_sd": 1.0}, lidar=runs.LIDAR)
    noise = tape(sim, 3, 20)
    full = np.array([[1.0, 0.0], [-1.0, 0.0], [-1.0, 0.0]])
    worlds = run(sim, noise, lambda t, n: full)
    arrival = [int(np.argmax([world.over[row] for world in worlds])) for row in range(3)]
    assert 0 < arrival[0] < arrival[1]
    assert worlds[-1].arrived.all()
    assert (worlds[-1].ego.x > 60.0).all()
    for world in worlds[arrival[0] :]:
        assert same(take(world, np.array([0])), take(worlds[arrival[0]], np.array([0])))
    assert run(sim, noise, lambda t, n: full, worlds[-1], 19)[-1] is worlds[-1]


def test_an_ego_off_the_road_does_not_arrive():
    sim = simulator(scene="merge", goal=60.0, start_seed=1)
    world = run(sim, tape(sim, 1, 20), lambda t, n: np.array([[0.0, 0.3 if t < 4 else 0.0]]))[-1]
    signals = sim.signals(world)
    assert [signals[name][0] for name in ("over", "on_road", "arrived")] == [1.0, 0.0, 0.0]


def test_a_crash():
    sim = simulator(scene="merge", start_seed=1)
    worlds = run(sim, tape(sim, 1, 80), lambda t, n: np.array([[1.0, 0.0]]))
    signals = [sim.signals(world) for world in worlds]
    first = int(np.argmax([s["crashed"][0] for s in signals]))
    assert first > 0
    assert signals[first - 1]["gap"] < 2.0
    assert signals[-1]["arrived"] == 0.0
    assert signals[-1]["x"] == signals[first]["x"]


def test_positive_steering_is_to_the_left():
    sim = simulator(scene="merge", start_seed=1)
    left = run(sim, tape(sim, 1, 3), lambda t, n: np.array([[0.0, 0.05]]))[-1]
    assert left.ego.y[0] > -4.0
    assert left.ego.heading[0] > 0.0
    assert left.ego.steering[0] > 0.0
    yaw = Action(np.array([1.5]), np.array([0.1]))
    world = run(sim, tape(sim, 1, 1), lambda t, n: yaw)[-1]
    assert world.ego.acceleration[0] == pytest.approx(1.5)
    assert world.ego.heading[0] == pytest.approx(0.01)


def test_signals(sim):
    world = run(sim, tape(sim, 3, 10))[-1]
    others = sim.setting.capacity
    for name, values in sim.signals(world).items():
        expected = (3, others) if name.startswith("others") or name == "distance" else (3,)
        assert values.shape == expected, name
        assert values.dtype == np.float64
        assert not np.isnan(values).any()
    absent = world.others.x == ABSENT
    assert absent.any() == (sim.config.scene == "intersection")


def test_acceleration_is_the_change_of_speed(sim):
    one, other = run(sim, tape(sim, 3, 6))[-2:]
    moving = ~other.over
    change = (other.ego.speed - one.ego.speed)[moving] / sim.dt
    np.testing.assert_allclose(other.ego.acceleration[moving], change, atol=1e-9)
    if sim.config.scene != "intersection":  # whose vehicles change places in the list
        change = (other.others.speed - one.others.speed)[moving] / sim.dt
        np.testing.assert_allclose(other.others.acceleration[moving], change, atol=1e-9)


@pytest.mark.parametrize("action", [None, np.zeros((2, 3)), np.zeros(2), "left"])
def test_invalid_actions_are_refused(action):
    sim = simulator(scene="merge", start_seed=1)
    with pytest.raises(UsageError, match="controller"):
        sim.step(sim.reset(np.zeros((2, 0))), action, np.zeros((2, 0)))


def test_an_action_that_is_nan_is_an_error_of_its_rollout():
    sim = simulator(scene="merge", start_seed=1)
    for action in (np.full((1, 2), np.nan), Action(np.array([np.nan]), np.zeros(1))):
        with pytest.raises(ValueError, match="action is NaN"):
            sim.step(sim.reset(np.zeros((1, 0))), action, np.zeros((1, 0)))


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
        first, second = noise[row : row + 1, 0], noise[row : row + 1, 1]
        alone = sim.step(sim.reset_drawn(first, values(row)), np.zeros((1, 2)), second)
        assert same(alone, batch.take(together, [row]))
        traffic = {name.removeprefix("traffic."): own[row] for name, own in VALUES.items() if "." in name}
        fixed = simulator(**options | {"ego_speed": VALUES["ego_speed"][row], "traffic": traffic})
        assert same(fixed.step(fixed.reset(first), np.zeros((1, 2)), second), alone)


def test_drivers_reach_the_speed_that_they_desire():
    sim = simulator(scene="highway", vehicles=2, traffic={"desired_speed": 18.0}, start_seed=3)
    world = run(sim, tape(sim, 1, 60), lambda t, n: np.zeros((n, 2)))[-1]
    np.testing.assert_allclose(world.others.speed, 18.0, atol=1.0)
