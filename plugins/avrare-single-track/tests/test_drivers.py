"""Drivers that react: against highway-env's, safe among themselves, each by its own numbers and delay."""

import numpy as np
import pytest
from pydantic import TypeAdapter

from avrare.base.laws import Law
from avrare.driving import Action
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.driver_model import PARAMETERS, idm
from avrare_single_track.simulator import build
from drivers import EGO, car, drive, simulator

HIGHWAY = {
    "time_gap": 1.5,
    "standstill_gap": 10.0,
    "acceleration": 3.0,
    "deceleration": 5.0,
    "braking_max": 1e9,
    "politeness": 0.4,
    "gain": 0.2,
    "safe_braking": 2.0,
}
"""highway-env's parameters; its gaps are between centres, so its vehicles are points with 10 m at rest."""


def test_a_follower_settles_at_the_model_s_own_gap():
    lead = {"name": "lead", "x": 60.0, "y": 1.75, "speed": 15.0}
    worlds = drive(simulator(lead, car("one", 0.0)), 900)
    others = worlds[-1].others
    gap = others.x[0, 0] - others.x[0, 1] - 4.298
    assert others.speed[0, 1] == pytest.approx(15.0, abs=0.01)
    assert gap == pytest.approx((2.0 + 15.0 * 1.5) / np.sqrt(1 - (15 / 25) ** 4), abs=0.1)


@pytest.mark.parametrize(("speed", "noise"), [(20.0, 0.0), (20.0, 0.5), (0.0, 0.0), (0.0, 0.5)])
def test_who_wants_to_stand_stops_and_never_reverses(speed, noise):
    crowd = [
        car("first", 80.0, speed=speed, desired=0.0, lane_changes=True, acceleration_sd=noise),
        car("second", 40.0, speed=speed, desired=0.0, acceleration_sd=noise, reaction_time=0.5),
        car("third", 0.0, acceleration_sd=noise),
    ]
    worlds = drive(simulator(*crowd), 300, n=20, seed=3)
    speeds, x = (np.stack([getattr(world.others, name) for world in worlds]) for name in ("speed", "x"))
    assert np.isfinite(speeds).all()
    assert speeds.min() == 0.0
    assert np.diff(x, axis=0).min() >= 0.0
    assert speeds[-100:].max() < 1.0  # noise makes it start now and then, until it reacts
    if not noise:
        assert not speeds[-100:, :, :2].any()


def test_the_acceleration_is_highway_env_s():
    from highway_env.road.road import Road, RoadNetwork
    from highway_env.vehicle import behavior

    road = Road(RoadNetwork.straight_road_network(1, length=10_000), np_random=np.random.default_rng(0))
    rng = np.random.default_rng(1)
    p = np.array([HIGHWAY.get(name, 0.0) for name in PARAMETERS])
    for _ in range(50):
        v, u, gap = rng.uniform(5, 30), rng.uniform(0, 25), rng.uniform(5, 120)
        p[0] = rng.uniform(20, 35)
        back = behavior.IDMVehicle(road, [100.0, 0.0], speed=v, target_speed=p[0])
        back.DELTA = 4.0
        front = behavior.IDMVehicle(road, [100.0 + gap, 0.0], speed=u)
        limit = min(p[0], back.lane.speed_limit)
        wanted = back.acceleration(back, front)
        if back.desired_gap(back, front) < 10.0:
            continue  # there highway-env's wanted gap falls below that of standstill
        assert idm(v, u, gap, np.array([limit, *p[1:]])) == pytest.approx(wanted, rel=1e-9)
        assert idm(v, 0.0, np.inf, np.array([limit, *p[1:]])) == pytest.approx(back.acceleration(back, None))


def test_lane_changes_are_highway_env_s():
    from highway_env.road.road import Road, RoadNetwork
    from highway_env.vehicle import behavior

    class Driver(behavior.IDMVehicle):
        POLITENESS = HIGHWAY["politeness"]

    rng, decided, compared = np.random.default_rng(3), 0, 0
    for _ in range(60):
        network = RoadNetwork.straight_road_network(2, length=10_000, speed_limit=100)
        road = Road(network, np_random=np.random.default_rng(0))
        near, far = rng.uniform(15, 60, 2), rng.uniform(10, 90, 2)
        xs = [200.0, 200.0 + near[0], 200.0 - near[1], 200.0 + far[0], 200.0 - far[1]]
        vs = rng.uniform(14, 26, 5)
        lanes = [1, 1, 1, 0, 0]  # highway-env counts from the left: 0 is our left lane
        for x, v, lane in zip(xs, vs, lanes, strict=True):
            one = Driver(road, [x, 4.0 * lane], speed=v, target_speed=25.0)
            one.DELTA = 4.0
            road.vehicles.append(one)
        subject = road.vehicles[0]
        after = subject.acceleration(subject, road.vehicles[3])
        if after < -2.0:
            continue  # here the driver's own braking counts as well
        wanted = subject.mobil(("0", "1", 0))
        cars = [
            car(f"c{k}", x, y=(1.75, -1.75)[lane], speed=v, length=1e-9, width=1.0, **HIGHWAY)
            for k, (x, v, lane) in enumerate(zip(xs, vs, lanes, strict=True))
        ]
        cars[0]["driver"] |= {"lane_changes": True, "lanes": [0, 1]}
        sim = simulator(*cars, ego={"x": -5000.0, "y": 5.25, "speed": 0.0})
        found = drive(sim, 1)[-1].drivers.lane[0, 0] == 1
        assert found == wanted
        compared, decided = compared + 1, decided + wanted
    assert compared > 40
    assert 5 < decided < compared - 5


def test_drivers_brake_for_the_ego():
    ego = {"x": 40.0, "y": 1.75, "speed": 0.0}
    worlds = drive(simulator(car("one", 0.0, speed=10.0), ego=ego), 300)
    assert worlds[-1].others.speed[0, 0] < 0.01
    assert 40.0 - worlds[-1].others.x[0, 0] - 4.298 == pytest.approx(2.0, abs=0.3)


def test_a_driver_brakes_for_a_standing_car_beyond_the_one_ahead():
    # the one ahead leaves the lane late
    vehicles = [
        {"name": "parked", "x": 220.0, "y": 1.75, "speed": 0.0},
        {"name": "lead", "x": 45.0, "y": 1.75, "speed": 25.0, "heading": 0.01},
    ]
    worlds = drive(simulator(*vehicles, car("one", 0.0)), 200)
    rates = np.array([world.others.acceleration[0, 2] for world in worlds])
    assert rates.min() > -2.5
    assert worlds[-1].others.speed[0, 2] < 0.1


def test_a_cool_driver_brakes_calmly_for_a_cut_in_and_hard_for_who_stands():
    for ahead, least, most in ((25.0, -2.0, -1.5), (0.0, -8.0, -8.0)):
        lead = {"name": "lead", "x": 14.0, "y": 1.75, "speed": ahead}
        cars = [car("one", 0.0, speed=25.0, coolness=share) for share in (1.0, 0.0)]
        cool, hasty = (drive(simulator(lead, each), 1)[1].others.acceleration[0, 1] for each in cars)
        assert least - 1e-9 <= cool <= most + 1e-9
        assert hasty == pytest.approx(-8.0)


def test_a_merge_waits_for_a_gap_and_stops_at_the_end_of_its_lane():
    merging = car("in", 0.0, y=-1.75, merge={"lane": 1}, lane_end=150.0)
    column = [{"name": f"c{k}", "x": 12.0 * k - 300.0, "y": 1.75, "speed": 20.0} for k in range(60)]
    closed = drive(simulator(*column, merging), 200)
    assert closed[-1].drivers.lane[0, 0] == 0
    assert closed[-1].others.x[0, -1] + 0.5 * 4.298 < 150.0
    assert closed[-1].others.speed[0, -1] < 0.5
    free = drive(simulator(merging), 80)
    assert free[-1].drivers.lane[0, 0] == 1
    assert free[-1].others.y[0, 0] == pytest.approx(1.75)
    assert free[15].others.heading[0, 0] > 0.0


def test_scripted_braking():
    brake = {"from_step": 5, "to_step": 9, "acceleration": -6.0}
    worlds = drive(simulator(car("one", 0.0, brake=[brake])), 12)
    rates = [world.others.acceleration[0, 0] for world in worlds]
    assert rates[6:11] == pytest.approx([-6.0] * 5)
    assert min(rates[1:6] + rates[11:]) > 0.0


def test_the_noise_of_acceleration_is_stationary():
    sim = simulator(*[car(f"v{k}", 200.0 * k, desired=20.0, acceleration_sd=0.4) for k in range(4)])
    worlds = drive(sim, 30, n=800, seed=2)
    moods = np.array([world.drivers.mood for world in worlds])
    assert moods[[0, 15, 30]].std(axis=(1, 2)) == pytest.approx([0.4] * 3, abs=0.02)
    lag = np.corrcoef(moods[10].ravel(), moods[20].ravel())[0, 1]
    assert lag == pytest.approx(np.exp(-1.0), abs=0.05)
    assert sim.noise_names[1] == "acceleration of v1"


def test_parameters_of_drivers_may_be_drawn():
    sim = simulator(car("one", 0.0, speed=15.0), car("two", 300.0))
    law = TypeAdapter(Law).validate_python({"law": "normal", "mean": 25.0, "sd": 2.0})
    drawn = sim.drawing({"vehicles.0.driver.desired_speed": law, "vehicles.0.x": law})
    chosen = np.array([16.0, 20.0, 30.0])
    values = {"vehicles.0.driver.desired_speed": chosen, "vehicles.0.x": np.array([5.0, 6.0, 7.0])}
    world = drawn.reset_drawn(np.zeros((3, 2)), values)
    assert world.others.x[:, 0] == pytest.approx([5.0, 6.0, 7.0])
    after = drawn.step(world, Action(np.zeros(3), np.zeros(3)), np.zeros((3, 2)))
    assert after.others.acceleration[:, 0] == pytest.approx(1.5 * (1 - (15.0 / chosen) ** 4), rel=1e-3)


def test_drivers_in_a_bend_drive_their_speed_at_their_own_offset():
    road = {"lane_centres": [-4.0, 0.0, 4.0], "line": [{"length": 1000.0, "curvature": 0.01}]}
    cars = [car("inside", 0.0, 4.0, desired=20.0), car("outside", 0.0, -4.0, desired=20.0)]
    sim = build(SingleTrackConfig.model_validate({"road": road, "ego": {**EGO, "y": 0.0}, "vehicles": cars}))
    worlds = drive(sim, 50)
    way = worlds[-1].others.x[0]
    speeds = np.stack([world.others.speed[0] for world in worlds])
    driven = 0.05 * (speeds[1:] + speeds[:-1]).sum(axis=0)
    np.testing.assert_allclose(way * (1.0 - 0.01 * np.array([4.0, -4.0])), driven, rtol=1e-9)


TABLE = np.array([25.0, 1.5, 2.0, 1.5, 2.0, 8.0])


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
    gaps = 500.0 - np.array([world.others.x[0, 0] for world in worlds]) - 4.298
    wanted = np.array([idm(v, 0.0, gap, TABLE) for v, gap in zip(speeds, gaps, strict=True)])
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
    gap = 60.0 - 4.298 - 0.1 * (15.0 + 0.05 * prompt[0])
    assert late[11] == pytest.approx(idm(15.0 + 0.1 * prompt[0], 0.0, gap, TABLE), rel=1e-9)
