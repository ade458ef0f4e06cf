"""Drivers on roads whose lanes begin, end or come towards them."""

import numpy as np
import pytest

from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.simulator import build
from drivers import EGO, car, drive

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


def merger(behind, **driver):
    """Return a driver that merges, and one that is faster by 4 m/s and so far behind [m]."""
    return [
        car("in", 0.0, y=-1.75, speed=18.0, merge={"lane": 1}, **driver),
        car("behind", -behind, speed=22.0, **driver),
    ]


def test_who_changes_lanes_is_seen_in_the_new_one_at_once():
    worlds = drive(along(*merger(45.0), road=ROAD), 3)
    free = drive(along(merger(45.0)[1], road=ROAD), 3)
    assert worlds[1].drivers.clock[0, 0] >= 0.0
    assert worlds[1].others.y[0, 0] < -1.7
    assert worlds[2].others.acceleration[0, 1] < free[2].others.acceleration[0, 0] - 0.5


@pytest.mark.parametrize("late", [0.0, 0.5, 1.0])
def test_a_merge_imposes_no_more_than_is_safe_even_on_who_reacts_late(late):
    merges = 0
    for behind in range(40, 80, 4):
        worlds = drive(along(*merger(behind, safe_braking=2.5, reaction_time=late), road=ROAD), 100)
        begun = next((k for k, world in enumerate(worlds) if world.drivers.lane[0, 0] == 1), None)
        if begun is not None:
            merges += 1
            assert max(-world.others.acceleration[0, 1] for world in worlds[begun:]) < 2.75
    assert merges > 3


def mirrored(world):
    others = world.others
    return np.array([-others.x, -others.y, others.speed, others.acceleration])


def test_oncoming_drivers_mind_ends_and_merge_as_those_along_the_road():
    plain = {"lane_centres": [-5.25, -1.75, 1.75, 5.25], "opposing": [2, 3]}
    forth = {**plain, "lane_spans": [{"lane": 0, "begin": -90.0, "end": 150.0}]}
    back = {**plain, "lane_spans": [{"lane": 3, "begin": -150.0, "end": 90.0}]}
    cars = [
        car("stays", 60.0, -5.25),
        car("merges", 0.0, -5.25, merge={"lane": 1, "from_step": 15}),
        car("ends", 40.0, -1.75, lane_end=170.0),
    ]
    turned = [{**one, "x": -one["x"], "y": -one["y"], "heading": np.pi} for one in cars]
    turned[1]["driver"] = {**turned[1]["driver"], "merge": {"lane": 2, "from_step": 15}}
    turned[2]["driver"] = {**turned[2]["driver"], "lane_end": -170.0}
    ego = {"x": -900.0, "y": 0.0, "speed": 0.0}
    worlds = drive(along(*cars, road=forth, ego=ego), 150)
    oncoming = drive(along(*turned, road=back, ego={**ego, "x": 900.0}), 150)
    others = worlds[-1].others
    same = np.array([others.x, others.y, others.speed, others.acceleration])
    np.testing.assert_allclose(mirrored(oncoming[-1]), same, atol=1e-9)
    assert 140.0 < others.x[0, 0] + 0.5 * 4.298 < 150.0
    assert others.y[0, 1] == pytest.approx(-1.75)
    assert 160.0 < others.x[0, 2] + 0.5 * 4.298 < 170.0


def test_a_driver_brakes_for_one_that_comes_towards_it_in_its_lane():
    road = {**ROAD, "opposing": [1]}
    ghost = {"name": "wrong", "x": 120.0, "y": -1.75, "speed": 10.0, "heading": np.pi}
    worlds = drive(along(car("one", 0.0, y=-1.75), ghost, road=road), 20)
    assert worlds[-1].others.acceleration[0, 0] < -2.0


def test_one_that_has_passed_does_not_keep_a_driver_from_the_opposing_lane():
    road = {**ROAD, "opposing": [1]}
    slow = {"name": "slow", "x": 40.0, "y": -1.75, "speed": 8.0}
    passed = {"name": "passed", "x": -20.0, "y": 1.75, "speed": 15.0, "heading": np.pi}
    driver = car("one", 0.0, y=-1.75, speed=15.0, lane_changes=True, lanes=[0, 1])
    found = [drive(along(slow, *more, driver, road=road), 10)[-1].others.y[0, -1] for more in ((), (passed,))]
    assert found[0] > -1.75
    assert found[1] == found[0]


def test_a_driver_brakes_for_the_end_of_the_lane_that_it_changes_into():
    road = {**ROAD, "lane_spans": [{"lane": 0, "end": 150.0}]}
    worlds = drive(along(car("one", 0.0, merge={"lane": 0}, braking_max=3.0), road=road), 200)
    assert worlds[10].drivers.clock[0, 0] > 0.0
    assert worlds[10].others.acceleration[0, 0] < -0.5
    assert 140.0 < worlds[-1].others.x[0, 0] + 0.5 * 4.298 < 150.0


def test_a_driver_sees_the_speed_of_a_crossing_car_along_the_road_alone():
    # it stands still along the road, in the driver's lane at the first step, and is gone later
    found = []
    for speed in (0.0, 12.0):
        crossing = {"name": "side", "x": 90.0, "y": 1.75, "speed": speed, "heading": 0.5 * np.pi}
        worlds = drive(along(crossing, car("one", 0.0), road=ROAD), 1)
        found.append(worlds[-1].others.acceleration[0, 1])
    assert found[1] == pytest.approx(found[0], abs=1e-9)


def test_a_driver_chooses_among_the_lanes_on_its_side_of_an_opposing_one():
    road = {"lane_centres": [-7.0, -3.5, 0.0, 3.5], "opposing": [2]}
    slow = {"name": "slow", "x": 40.0, "y": -3.5, "speed": 8.0}
    worlds = drive(along(slow, car("one", 0.0, y=-3.5, lane_changes=True), road=road), 60)
    assert worlds[-1].others.y[0, 1] == pytest.approx(-7.0)
