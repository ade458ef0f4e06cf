"""CommonRoad files: obstacles, lanes, and roads that are refused."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import Road, Scene
from avrare.results.recordings import FIELDS, Recording
from avrare_recordings.formats.commonroad import _read_pose, read_commonroad, to_commonroad
from avrare_recordings.roads.straight_road import find_straight_lanes

DATA = Path(__file__).parents[3].parent / "shared" / "data" / "commonroad"
ROAD = Road((0.0,), 3.5)


@pytest.fixture
def sample():
    if not DATA.exists():
        pytest.skip("the sample scenario is not here")
    return str(DATA / "Complex.xml")


def test_obstacles_and_lanes_of_the_sample(sample):
    found = read_commonroad(sample, "13")
    assert (found.dt, found.start, found.samples) == (0.1, 0.0, 80)
    assert found.scene.names == ("14", "15")
    assert found.scene.moving.tolist() == [False, True]
    assert found.scene.road.lane_centres == pytest.approx((-1.75, 1.75, 5.25))
    assert (found.scene.road.lane_width, found.scene.road.access_ramp) == (pytest.approx(3.5), (0,))
    table = np.genfromtxt(DATA / "complex_obstacles.csv", delimiter=",", names=True)
    for who, number, column in (("ego", 13, ()), ("others", 14, (0,)), ("others", 15, (1,))):
        rows = table[table["id"] == number]
        for field, name in (("x", "x"), ("y", "y"), ("heading", "heading"), ("speed", "v")):
            values = found.signals[f"{who}_{field}"][(slice(0, len(rows)), *column)]
            np.testing.assert_allclose(values, rows[name], atol=1e-4)


def test_the_ego_must_be_a_moving_obstacle(sample):
    wrong = {None: "no ego is chosen", "14": "no moving obstacle '14'", "x": "no moving obstacle"}
    for ego, text in wrong.items():
        with pytest.raises(UsageError, match=text) as caught:
            read_commonroad(sample, ego)
        assert caught.value.hint == "choose the ego; there are: 13, 15"


def test_files_that_are_not_commonroad_scenarios(tmp_path):
    for text in ("", "<a/>", "not xml"):
        (tmp_path / "s.xml").write_text(text)
        with pytest.raises(UsageError, match="not a CommonRoad scenario"):
            read_commonroad(str(tmp_path / "s.xml"), "1")
    with pytest.raises(UsageError, match="no such file"):
        read_commonroad(str(tmp_path / "none.xml"), "1")


def test_an_ego_with_gaps_is_refused_before_arrays_are_made(tmp_path):
    track, none = np.arange(4.0), np.zeros(0)
    scene = Scene(0.1, ROAD, 4.5, 1.8, (), none, none, none.astype(bool))
    states = {f"ego_{field}": track for field in FIELDS}
    states |= {f"others_{field}": np.zeros((4, 0)) for field in FIELDS}
    text = to_commonroad(Recording("s", 0.1, 0.0, states, scene), "s")
    path = tmp_path / "s.xml"
    path.write_text(text)
    assert read_commonroad(str(path), "1").samples == 4
    for far in ("5", "10000000000000000"):
        path.write_text(text.replace("<exact>3</exact>", f"<exact>{far}</exact>"))
        with pytest.raises(UsageError, match="obstacle 1 has gaps in time"):
            read_commonroad(str(path), "1")
    path.write_text(text.replace("<exact>3</exact>", f"<exact>{10**40}</exact>"))
    with pytest.raises(UsageError, match=r"obstacle 1 has a state at step 10{29}$"):
        read_commonroad(str(path), "1")


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 10**400, -(10**400), None, "1"])
def test_numbers_that_are_none_are_refused(value):
    state = SimpleNamespace(position=np.zeros(2), orientation=0.0, velocity=value, time_step=0)
    with pytest.raises(UsageError, match=r"s\.xml: it has no exact position, orientation and velocity"):
        _read_pose("s.xml", "it", state)
    assert _read_pose("s.xml", "it", SimpleNamespace(**vars(state) | {"velocity": 3})) == [0.0, 0.0, 0.0, 3.0]


def lanelet(number, points, width=3.5, kinds=()):
    """Return a lanelet around a polyline."""
    centre = np.array(points, dtype=float)
    along = np.gradient(centre, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    kinds = [SimpleNamespace(value=kind) for kind in kinds]
    unmarked = SimpleNamespace(value="no_marking")
    return SimpleNamespace(
        lanelet_id=number,
        center_vertices=centre,
        lanelet_type=kinds,
        left_vertices=centre + 0.5 * width * normal,
        right_vertices=centre - 0.5 * width * normal,
        line_marking_left_vertices=unmarked,
        line_marking_right_vertices=unmarked,
    )


def line(y, begin=0.0, end=100.0, count=11, angle=0.0):
    x = np.linspace(begin, end, count)
    points = np.stack([x, np.full(count, y)], axis=1)
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.0, np.pi / 2, 3.0])
def test_lanes_are_found_at_every_angle_of_the_road(angle):
    ramp = lanelet(2, line(0.0, 0.0, 60.0, angle=angle), kinds=["accessRamp"])
    others = [lanelet(1, line(3.5, angle=angle)), lanelet(3, line(0.01, 60.0, 100.0, angle=angle))]
    road, direction = find_straight_lanes("s.xml", [*others, ramp])
    assert np.cos(direction - angle) == pytest.approx(1.0)
    assert road.lane_centres == pytest.approx((0.005, 3.5), abs=1e-6)
    assert road.lane_width == pytest.approx(3.5)
    assert road.access_ramp == (0,)
    assert (road.begin, road.end) == pytest.approx((0.0, 100.0))


def test_the_taper_of_a_ramp_is_not_a_lane():
    taper = [(x, -3.5 + 3.5 * x / 20.0) for x in range(21)]
    road, _ = find_straight_lanes("s.xml", [lanelet(1, line(0.0)), lanelet(2, taper)])
    assert road.lane_centres == (0.0,)


@pytest.mark.parametrize(
    ("lanelets", "text"),
    [
        ([lanelet(7, [(x, 1e-3 * x * x) for x in range(100)])], "lanelet 7 is curved"),
        ([lanelet(1, line(0)), lanelet(2, [(100 + x, 0.01 * x * x) for x in range(40)])], "2 is curved"),
        ([lanelet(1, line(0.0)), lanelet(2, line(3.5, 90.0, 0.0))], "lanelet 2 runs against the others"),
        ([lanelet(1, line(0.0)), lanelet(2, line(4.0), width=4.5)], "3.50 to 4.50 m wide"),
        ([], "there are no lanelets"),
    ],
)
def test_other_roads_are_refused(lanelets, text):
    with pytest.raises(UsageError, match=text):
        find_straight_lanes("s.xml", lanelets)
