"""Drivers that react: against highway-env's, safe among themselves, each particle by its own numbers."""

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from avrare.base.batch import leaves, take
from avrare.base.laws import Law
from avrare.driving import Action
from avrare.driving.geometry import Rectangle, signed_distance
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.driver_model import PARAMETERS, idm
from avrare_single_track.simulator import build

EGO = {"x": -200.0, "y": -1.75, "speed": 20.0}
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


def car(name, x, y=1.75, speed=20.0, desired=25.0, **driver):
    sizes = {key: driver.pop(key) for key in ("length", "width") if key in driver}
    return {
        "name": name, "x": x, "y": y, "speed": speed, **sizes,
        "driver": {"desired_speed": desired, "lane_changes": False, **driver},
    }  # fmt: skip


def simulator(*vehicles, ego=EGO, dt=0.1):
    return build(SingleTrackConfig.model_validate({"dt": dt, "ego": ego, "vehicles": list(vehicles)}))


def drive(sim, steps, n=1, seed=None):
    """Return the worlds of a drive whose ego keeps its speed."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((steps + 1, n, sim.noise_size)) * (seed is not None)
    worlds = [sim.reset(noise[0])]
    for row in noise[1:]:
        worlds.append(sim.step(worlds[-1], Action(np.zeros(n), np.zeros(n)), row))
    return worlds


def test_a_free_driver_reaches_its_desired_speed():
    worlds = drive(simulator(car("one", 0.0, speed=15.0, acceleration=2.0)), 600)
    assert worlds[-1].others.speed[0, 0] == pytest.approx(25.0, abs=0.1)
    assert worlds[1].others.acceleration[0, 0] == pytest.approx(2.0 * (1 - (15 / 25) ** 4))


def test_a_follower_settles_at_the_model_s_own_gap():
    lead = {"name": "lead", "x": 60.0, "y": 1.75, "speed": 15.0}
    worlds = drive(simulator(lead, car("one", 0.0)), 900)
    others = worlds[-1].others
    gap = others.x[0, 0] - others.x[0, 1] - 4.298
    assert others.speed[0, 1] == pytest.approx(15.0, abs=0.01)
    assert gap == pytest.approx((2.0 + 15.0 * 1.5) / np.sqrt(1 - (15 / 25) ** 4), abs=0.1)


def test_the_acceleration_is_highway_env_s():
    behavior = pytest.importorskip("highway_env.vehicle.behavior")
    from highway_env.road.road import Road, RoadNetwork

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
    behavior = pytest.importorskip("highway_env.vehicle.behavior")
    from highway_env.road.road import Road, RoadNetwork

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


SIZE = np.asarray(4.298), np.asarray(1.674)


def dense(**driver):
    return [
        car(f"v{k}", 28.0 * (k // 3) + 4.0 * (k % 3), (-1.75, 1.75, 5.25)[k % 3], 20.0 + k % 5, 23.0 + k % 7,
            lane_changes=True, **driver)
        for k in range(12)
    ]  # fmt: skip


def test_dense_traffic_does_not_collide_and_changes_lanes():
    sim = simulator(*dense(acceleration_sd=0.3), ego={"x": -60.0, "y": 1.75, "speed": 0.0})
    worlds = drive(sim, 300, n=20, seed=1)
    changed = (worlds[-1].drivers.lane != worlds[0].drivers.lane).mean()
    assert 0.02 < changed < 0.9
    for world in worlds[::10]:
        others = world.others
        for k in range(11):
            one, rest = (
                Rectangle(*(part[:, c] for part in (others.x, others.y, others.heading)), *SIZE)
                for c in (slice(k, k + 1), slice(k + 1, None))
            )
            assert (signed_distance(one, rest) > 0.0).all()


def test_a_row_does_not_depend_on_the_others():
    sim = simulator(*dense(acceleration_sd=0.5))
    rng = np.random.default_rng(4)
    noise = rng.standard_normal((30, 6, sim.noise_size))

    def run(rows):
        world = sim.reset(noise[0][rows])
        for row in noise[1:]:
            world = sim.step(world, Action(np.zeros(len(rows)), np.zeros(len(rows))), row[rows])
        return world

    whole, alone = run(np.arange(6)), run(np.array([4]))
    pairs = zip(leaves(take(whole, np.array([4]))), leaves(alone), strict=True)
    assert all(np.array_equal(a, b) for a, b in pairs)


def test_a_step_does_not_change_the_world_it_starts_from():
    sim = simulator(*dense())
    before = drive(sim, 3)[-1]
    copy = [leaf.copy() for leaf in leaves(before)]
    sim.step(before, Action(np.zeros(1), np.zeros(1)), np.ones((1, sim.noise_size)))
    assert all(np.array_equal(a, b) for a, b in zip(leaves(before), copy, strict=True))


def test_drivers_brake_for_the_ego():
    ego = {"x": 40.0, "y": 1.75, "speed": 0.0}
    worlds = drive(simulator(car("one", 0.0, speed=10.0), ego=ego), 300)
    assert worlds[-1].others.speed[0, 0] < 0.01
    assert 40.0 - worlds[-1].others.x[0, 0] - 4.298 == pytest.approx(2.0, abs=0.3)


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
    worlds = drive(
        simulator(car("one", 0.0, brake=[{"from_step": 5, "to_step": 9, "acceleration": -6.0}])), 12
    )
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


def test_a_vehicle_has_one_mind():
    both = car("one", 0.0) | {"drive": {"lanes": [1]}}
    with pytest.raises(ValidationError, match="not both"):
        simulator(both)
    with pytest.raises(ValidationError, match="drives on lane 7"):
        simulator(car("one", 0.0, merge={"lane": 7}))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"lanes": (-1, 2)}, "greater than or equal to 0"),
        ({"lanes": (2, 0)}, "the first lane must not be above the last one"),
        (
            {"brake": [{"from_step": 9, "to_step": 3, "acceleration": -2.0}]},
            "from_step must not be above to_step",
        ),
    ],
)
def test_reversed_and_negative_ranges_are_refused(options, words):
    with pytest.raises(ValidationError, match=words):
        simulator(car("a", 0.0, **options))


def test_drivers_in_a_bend_drive_their_speed_at_their_own_offset():
    road = {"lane_centres": [-4.0, 0.0, 4.0], "line": [{"length": 1000.0, "curvature": 0.01}]}
    cars = [car("inside", 0.0, 4.0, desired=20.0), car("outside", 0.0, -4.0, desired=20.0)]
    sim = build(SingleTrackConfig.model_validate({"road": road, "ego": {**EGO, "y": 0.0}, "vehicles": cars}))
    worlds = drive(sim, 50)
    way = worlds[-1].others.x[0]
    speeds = np.stack([world.others.speed[0] for world in worlds])
    driven = 0.05 * (speeds[1:] + speeds[:-1]).sum(axis=0)
    np.testing.assert_allclose(way * (1.0 - 0.01 * np.array([4.0, -4.0])), driven, rtol=1e-9)


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


def test_a_row_of_late_drivers_does_not_depend_on_the_others():
    sim = simulator(*dense(acceleration_sd=0.5, reaction_time=0.8, reaction_sd=0.4))
    noise = np.random.default_rng(4).standard_normal((30, 4, sim.noise_size))

    def run(rows):
        world = sim.reset(noise[0][rows])
        for row in noise[1:]:
            before = [leaf.copy() for leaf in leaves(world)]
            after = sim.step(world, Action(np.zeros(len(rows)), np.zeros(len(rows))), row[rows])
            assert all(np.array_equal(a, b) for a, b in zip(leaves(world), before, strict=True))
            world = after
        return world

    whole, alone = run(np.arange(4)), run(np.array([2]))
    pairs = zip(leaves(take(whole, np.array([2]))), leaves(alone), strict=True)
    assert all(np.array_equal(a, b) for a, b in pairs)


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


ROAD = {"lane_centres": [-1.75, 1.75]}


def along(*vehicles, road, ego=EGO):
    return build(SingleTrackConfig.model_validate({"road": road, "ego": ego, "vehicles": list(vehicles)}))


def test_a_lane_that_ends_is_left_or_stopped_in():
    road = {**ROAD, "lane_spans": [{"lane": 0, "begin": -100.0, "end": 150.0}], "access_ramp": [0]}
    leaving = drive(along(car("in", 0.0, y=-1.75, lane_changes=True), road=road), 120)
    assert leaving[-1].others.y[0, 0] == pytest.approx(1.75)
    blocked = [{"name": f"c{k}", "x": 9.0 * k - 300.0, "y": 1.75, "speed": 20.0} for k in range(80)]
    staying = drive(along(*blocked, car("in", 0.0, y=-1.75, lane_changes=True), road=road), 200)
    assert staying[-1].others.y[0, -1] == -1.75
    assert 140.0 < staying[-1].others.x[0, -1] + 0.5 * 4.298 < 150.0


def test_nobody_changes_into_a_lane_that_is_not_there():
    slow = {"name": "slow", "x": 40.0, "y": 1.75, "speed": 8.0}
    for span, changes in (({"begin": -500.0}, True), ({"begin": 900.0}, False), ({"end": 20.0}, False)):
        road = {**ROAD, "lane_spans": [{"lane": 0, **span}]}
        worlds = drive(along(slow, car("one", 0.0, lane_changes=True), road=road), 60)
        assert (worlds[-1].others.y[0, 1] < 1.0) == changes


def mirrored(world):
    others = world.others
    return np.array([-others.x, -others.y, others.speed, others.acceleration])


def test_oncoming_drivers_drive_as_those_along_the_road():
    road = {"lane_centres": [-5.25, -1.75, 1.75, 5.25], "opposing": [2, 3]}
    plain = [
        car(f"v{k}", 28.0 * (k // 2), (-5.25, -1.75)[k % 2], 18.0 + 3 * (k % 3),
            (14.0, 26.0, 24.0, 17.0)[k % 4], lane_changes=True, acceleration_sd=0.3)
        for k in range(8)
    ]  # fmt: skip
    turned = [{**one, "x": -one["x"], "y": -one["y"], "heading": np.pi} for one in plain]
    ego = {"x": -900.0, "y": 0.0, "speed": 0.0}
    forth = drive(along(*plain, road=road, ego=ego), 120, seed=3)
    oncoming = drive(along(*turned, road=road, ego={**ego, "x": 900.0}), 120, seed=3)
    same = np.array([forth[-1].others.x, forth[-1].others.y, forth[-1].others.speed,
                     forth[-1].others.acceleration])  # fmt: skip
    np.testing.assert_allclose(mirrored(oncoming[-1]), same, atol=1e-9)
    assert (forth[-1].drivers.lane != forth[0].drivers.lane).any()
    assert np.cos(oncoming[-1].others.heading).max() < -0.9


def test_a_driver_brakes_for_one_that_comes_towards_it_in_its_lane():
    road = {**ROAD, "opposing": [1]}
    ghost = {"name": "wrong", "x": 120.0, "y": -1.75, "speed": 10.0, "heading": np.pi}
    worlds = drive(along(car("one", 0.0, y=-1.75), ghost, road=road), 20)
    assert worlds[-1].others.acceleration[0, 0] < -2.0


@pytest.mark.parametrize(
    ("road", "words"),
    [
        ({"lane_spans": [{"lane": 0}]}, "give begin, end or both"),
        ({"lane_spans": [{"lane": 0, "begin": 5.0, "end": 5.0}]}, "must begin before it ends"),
        ({"lane_spans": [{"lane": 7, "end": 5.0}]}, "lane_spans must name lanes"),
        ({"lane_spans": [{"lane": 0, "end": 5.0}, {"lane": 0, "begin": 9.0}]}, "names a lane twice"),
        ({"opposing": [0, 2]}, "side by side"),
    ],
)
def test_roads_that_cannot_be(road, words):
    with pytest.raises(ValidationError, match=words):
        along(road=road)
    with pytest.raises(ValidationError, match="reaction_time above 0"):
        simulator(car("a", 0.0, reaction_sd=0.2))
