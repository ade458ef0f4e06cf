"""The driver along waypoints: its path, its steering, its gaps, and what it refuses."""

import numpy as np
import pytest
from pydantic import ValidationError

from avrare.driving import Prediction, Vehicles
from avrare_highway_env.config import PathFollowerConfig
from avrare_highway_env.path_follower import Path, build
from avrare_highway_env.sensing import Ego

NORTH = ((2.0, -60.0), (2.0, 60.0))
ANGLES = np.linspace(0.0, np.pi / 2.0, 13)
BEND = [(30.0 * np.sin(angle), 30.0 - 30.0 * np.cos(angle)) for angle in ANGLES]


def follower(waypoints=NORTH, **options):
    return build(PathFollowerConfig(waypoints=waypoints, **options))


def vehicles(rows):
    """Return x, y, heading, speed of each."""
    x, y, heading, speed = np.moveaxis(np.array(rows, dtype=float), -1, 0)
    return Vehicles(x, y, heading, speed, 0.0 * x)


def ego(here, others=((1e6, 1e6, 0.0, 0.0),)):
    own = vehicles([here])
    zero = np.zeros(1)
    return Ego(*vars(own).values(), np.zeros((1, 6)), zero, vehicles([others]))


def wanted(here, others=((1e6, 1e6, 0.0, 0.0),), **options):
    """Return throttle and steering of an ego on the way north."""
    return follower(**options).act(None, ego(here, others), None)[0][0]


def test_places_on_a_path():
    path = Path([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)])
    x, y = np.array([[-3.0, 4.0], [12.0, 7.0]]), np.array([[4.0, 1.0], [3.0, 25.0]])
    along, off, direction = path.project(x, y)
    np.testing.assert_allclose(along, [[0.0, 4.0], [13.0, 35.0]])
    np.testing.assert_allclose(off, [[5.0, 1.0], [2.0, 3.0]])
    np.testing.assert_allclose(direction, [[0.0, 0.0], [np.pi / 2, np.pi / 2]])
    np.testing.assert_allclose(path.at(along), [[[0, 4], [10, 10]], [[0, 0], [3, 25]]])


@pytest.mark.parametrize(
    ("waypoints", "message"),
    [
        ([], "at least two waypoints, found 0"), ([[0, 0]], "at least two waypoints, found 1"),
        ([[0, 0], [1, 1], [1, 1]], "waypoint 2 is the same"), ([[0, 0], [1, 1, 1]], "waypoints.1"),
        ([[0, 0], [1, float("nan")]], "finite"),
    ],
)  # fmt: skip
def test_invalid_paths_are_refused(waypoints, message):
    with pytest.raises(ValidationError, match=message):
        PathFollowerConfig(waypoints=waypoints)


def test_it_steers_towards_the_path():
    up = np.pi / 2
    assert wanted((2.0, 0.0, up, 8.0))[1] == pytest.approx(0.0, abs=1e-12)
    assert wanted((2.5, 0.0, up, 8.0))[1] > 0.0 > wanted((1.5, 0.0, up, 8.0))[1]
    assert wanted((2.0, 0.0, up - 0.1, 8.0))[1] > 0.0 > wanted((2.0, 0.0, up + 0.1, 8.0))[1]


def test_it_keeps_its_speed_and_its_distance():
    here = (2.0, 0.0, np.pi / 2, 8.0)
    ahead, far, slow = ((2.0, y, np.pi / 2, v) for y, v in ((20.0, 8.0), (40.0, 8.0), (20.0, 4.0)))
    assert wanted(here)[0] == pytest.approx(0.0, abs=1e-9)
    assert wanted((*here[:3], 5.0))[0] > 0.0
    assert 0.0 > wanted(here, [far])[0] > wanted(here, [ahead])[0] > wanted(here, [slow])[0]
    assert wanted(here, [far, ahead])[0] == wanted(here, [ahead])[0]
    assert wanted(here, [(6.0, 20.0, np.pi / 2, 4.0)])[0] == wanted(here)[0]
    assert wanted(here, [(2.0, -20.0, np.pi / 2, 12.0)])[0] == wanted(here)[0]


def test_the_gap_is_that_of_the_model():
    """Work it out: gap = 20 - 5 m, both 8 m/s: a (1 - (v / v0)^4 - ((s0 + v T) / gap)^2)."""
    here, leader = (2.0, 0.0, np.pi / 2, 8.0), (2.0, 20.0, np.pi / 2, 8.0)
    acceleration = 3.0 * (1.0 - 0.8**4 - ((3.0 + 8.0 * 1.0) / 15.0) ** 2)
    assert wanted(here, [leader], cruise_speed=10.0)[0] == pytest.approx(acceleration / 5.0)


def test_a_crossing_vehicle_counts_where_it_reaches_into_the_corridor():
    here = (2.0, 0.0, np.pi / 2, 8.0)
    inside, outside = (2.0 + 1.5 + 2.4, 12.0, np.pi, 6.0), (2.0 + 1.5 + 2.6, 12.0, np.pi, 6.0)
    assert wanted(here, [inside])[0] < -0.5
    assert wanted(here, [outside])[0] == wanted(here)[0]
    assert wanted(here, [outside], foresight=1.0)[0] < -0.5
    gone = (-6.0, 12.0, np.pi, 6.0)
    assert wanted(here, [gone], foresight=1.0)[0] == wanted(here)[0]


def test_it_stops_and_does_not_reverse():
    driver = follower([(0.0, 0.0), (300.0, 0.0)], cruise_speed=15.0)
    place, speed, parked = 0.0, 15.0, (120.0, 0.0, 0.0, 0.0)
    for _ in range(600):
        throttle = driver.act(None, ego((place, 0.0, 0.0, speed), [parked]), None)[0][0, 0]
        place, speed = place + 0.1 * speed, speed + 0.5 * throttle
        assert speed > -1e-9
    assert speed < 0.1
    assert 1.0 < 120.0 - place - 5.0 < 6.0


def test_it_stays_on_a_bend():
    """Follow a quarter of a circle of 30 m by the bicycle model of highway-env, in steps of 0.1 s."""
    driver, speed = follower(BEND), 8.0
    x, y, heading = 0.0, 0.0, 0.0
    for _ in range(50):
        _, steering = driver.act(None, ego((x, y, heading, speed)), None)[0][0]
        slip = np.arctan(0.5 * np.tan(steering * np.pi / 4))
        x, y = x + 0.1 * speed * np.cos(heading + slip), y + 0.1 * speed * np.sin(heading + slip)
        heading += 0.1 * speed * np.sin(slip) / 2.5
        assert driver.path.project(np.array([x]), np.array([y]))[1][0] < 0.5
    assert heading > 1.0


def test_exact_predictions_are_as_good_as_the_truth():
    rng = np.random.default_rng(4)
    driver, here = follower(foresight=3.0), (2.0, -30.0, np.pi / 2, 7.0)
    assert driver.horizon == 30
    for x, y, heading, speed in rng.uniform((-20, -20, -3, 2), (20, 40, 3, 9), (40, 4)):
        seen, way = ego(here, [(x, y, heading, speed)]), 0.1 * speed * np.arange(31)
        place = x + way * np.cos(heading), y + way * np.sin(heading)
        prediction = Prediction(*(part[None, None] for part in place))
        np.testing.assert_allclose(driver.act(None, seen, prediction)[0], driver.act(None, seen, None)[0])


def test_what_has_no_track_is_not_there_and_what_stands_is_parallel_to_the_path():
    driver, seen = follower(foresight=3.0), ego((2.0, -30.0, np.pi / 2, 8.0))
    free = driver.act(None, seen, None)[0][0, 0]
    nobody = np.full((1, 1, 31), np.inf)
    assert driver.act(None, seen, Prediction(nobody, nobody))[0][0, 0] == free
    ahead, beside = (Prediction(np.full((1, 1, 31), x), np.full((1, 1, 31), -15.0)) for x in (2.0, 4.7))
    assert driver.act(None, seen, ahead)[0][0, 0] < -0.5
    assert driver.act(None, seen, beside)[0][0, 0] == free
