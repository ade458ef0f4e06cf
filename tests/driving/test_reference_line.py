"""Reference lines: round trips, closed forms, brute force, and the coordinate system of CommonRoad."""

import numpy as np
import pytest
from scipy.special import fresnel

from avrare.base.errors import UsageError
from avrare.driving.reference_line import CurvedLine, Piece, PolygonalLine

PIECES = Piece(80), Piece(60, 0, 1 / 150), Piece(80, 1 / 150, 1 / 150), Piece(60, 1 / 150, -1 / 200)
BENDS = CurvedLine(PIECES, 10.0, -5.0, 0.3)


def random_places(line, rng, count=400, beyond=40.0, aside=12.0):
    s = rng.uniform(-beyond, line.length + beyond, count)
    return s, rng.uniform(-aside, aside, count)


def polygonal(line, count=150):
    x, y, _, _ = line.frame(np.linspace(0.0, line.length, count))
    return PolygonalLine(np.stack([x, y], axis=1))


def jagged(rng):
    return PolygonalLine(np.cumsum(rng.normal([3.0, 0.0], [0.5, 0.3], (60, 2)), axis=0))


class TestRoundTrip:
    @pytest.mark.parametrize("build", [lambda _: BENDS, lambda _: polygonal(BENDS), jagged])
    def test_both_ways(self, build):
        rng = np.random.default_rng(3)
        line = build(rng)
        s, d = random_places(line, rng, aside=3.0)
        again = line.to_road(*line.to_plane(s, d))
        np.testing.assert_allclose(again, (s, d), atol=1e-9)

    def test_any_shape_and_none(self):
        s, d = random_places(BENDS, np.random.default_rng(1), 24)
        x, y = BENDS.to_plane(s.reshape(2, 3, 4), d.reshape(2, 3, 4))
        found = BENDS.to_road(x, y)
        assert found[0].shape == (2, 3, 4)
        for i in range(24):  # a point does not depend on its neighbours
            one = BENDS.to_road(x.ravel()[i], y.ravel()[i])
            assert (one[0], one[1]) == (found[0].ravel()[i], found[1].ravel()[i])
        assert BENDS.to_road(np.zeros((0, 2)), np.zeros((0, 2)))[0].shape == (0, 2)


class TestExactShapes:
    def test_straight(self):
        line = CurvedLine((Piece(10.0),), 1.0, 2.0, np.pi / 2)
        found = line.to_road(np.array([-2.0]), np.array([500.0]))
        np.testing.assert_allclose(found, [[498.0], [3.0]], atol=1e-12)

    def test_more_than_half_a_circle(self):
        line = CurvedLine((Piece(5.0 * np.pi * 1.5, 0.2, 0.2),))
        angle = np.linspace(0.1, 1.4 * np.pi, 20)
        x, y = 4.0 * np.sin(angle), 5.0 - 4.0 * np.cos(angle)
        np.testing.assert_allclose(line.to_road(x, y), (5.0 * angle, np.full(20, 1.0)), atol=1e-12)

    def test_clothoid_is_the_fresnel_integral(self):
        rate = 1e-3
        line = CurvedLine((Piece(100.0, 0.0, 100.0 * rate),))
        s = np.linspace(0.0, 100.0, 40)
        sine, cosine = fresnel(s * np.sqrt(rate / np.pi))
        x, y, heading, curvature = line.frame(s)
        np.testing.assert_allclose((x, y), np.sqrt(np.pi / rate) * np.stack([cosine, sine]), atol=1e-12)
        np.testing.assert_allclose(heading, 0.5 * rate * s**2, atol=1e-12)
        np.testing.assert_allclose(curvature[:-1], rate * s[:-1], atol=1e-15)  # it ends at the last one


class TestProjection:
    @pytest.mark.parametrize("line", [BENDS, polygonal(BENDS)])
    def test_nearest_foot_by_brute_force(self, line):
        rng = np.random.default_rng(7)
        s, d = random_places(line, rng, 60, beyond=-1.0, aside=25.0)
        x, y = line.to_plane(s, d)
        dense = np.linspace(0.0, line.length, 40_001)
        foot_x, foot_y, _, _ = line.frame(dense)
        distance = np.hypot(x[:, None] - foot_x, y[:, None] - foot_y)
        found_s, found_d = line.to_road(x, y)
        tolerance = 0.01 if line is BENDS else 0.2  # tangents of a polygon turn along its segments
        assert np.abs(np.abs(found_d) - distance.min(axis=1)).max() < tolerance
        assert np.abs(found_s - dense[distance.argmin(axis=1)]).max() < 25.0 * tolerance

    def test_beyond_the_centre_of_curvature_is_nan(self):
        circle = CurvedLine((Piece(40.0, 0.1, 0.1),))
        x, y = circle.to_plane(np.array([20.0, 20.0]), np.array([9.9, 10.1]))
        s, d = circle.to_road(x, y)
        np.testing.assert_allclose((s[0], d[0]), (20.0, 9.9))
        assert not (np.isfinite(d[1]) and abs(s[1] - 20.0) < 1.0)  # another foot, or none

    def test_agrees_with_the_coordinate_system_of_commonroad(self):
        clcs = pytest.importorskip("commonroad_clcs.pycrccosy")
        line = polygonal(CurvedLine((Piece(50), Piece(40, 0, 1 / 60), Piece(60, 1 / 60, 1 / 60))))
        oracle = clcs.CurvilinearCoordinateSystem(list(line.points), 20.0, 0.1)
        s, d = random_places(line, np.random.default_rng(2), 300, beyond=-3.0, aside=8.0)
        x, y = line.to_plane(s, d)
        theirs = np.array([oracle.convert_to_curvilinear_coords(*point) for point in zip(x, y, strict=True)])
        moved = theirs[:, 0] - s  # it prolongs the line at its beginning
        assert np.ptp(moved) < 1e-6
        np.testing.assert_allclose(theirs[:, 1], d, atol=1e-6)


class TestAlongAnOffset:
    def test_length_of_the_offset_curve(self):
        s = np.linspace(0.0, 280.0, 20_001)
        for d in (-3.5, 0.0, 5.0):
            x, y = BENDS.to_plane(s, np.full_like(s, d))
            measured = np.hypot(np.diff(x), np.diff(y)).sum()
            reached = BENDS.advance(np.array([0.0]), np.array([d]), np.array([measured]))
            assert reached[0] == pytest.approx(280.0, abs=1e-4)

    def test_straight_adds(self):
        line = CurvedLine((Piece(10.0),))
        assert line.advance(np.array([3.0]), np.array([9.0]), np.array([4.0]))[0] == 7.0


def test_many_points_find_the_segments_that_each_of_them_finds():
    rng = np.random.default_rng(5)
    turn = np.cumsum(rng.normal(0.0, 0.05, 700))
    line = PolygonalLine(np.cumsum(np.stack([np.cos(turn), np.sin(turn)], axis=1), axis=0))
    x, y = rng.uniform(-300.0, 300.0, (2, 500))
    x[:3] = np.nan, np.inf, line.points[32, 0]
    many = line.to_road(x, y)
    single = [line.to_road(x[k : k + 1], y[k : k + 1]) for k in range(500)]
    for axis in range(2):
        np.testing.assert_array_equal(many[axis], np.concatenate([pose[axis] for pose in single]))


def test_a_line_that_turns_back_on_itself_has_a_direction_everywhere():
    spike = PolygonalLine(np.array([[0.0, 0.0], [10.0, 0.0], [9.5, 0.0], [20.0, 0.0]]))
    s, d = spike.to_road(np.linspace(-5.0, 25.0, 200), np.full(200, 1.5))
    np.testing.assert_allclose(s, np.linspace(-5.0, 25.0, 200))
    np.testing.assert_allclose(d, 1.5)
    with pytest.raises(UsageError, match="two points that differ"):
        PolygonalLine(np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 0.0]]))


@pytest.mark.filterwarnings("error")
def test_no_point_has_a_station_without_an_offset():
    zigzag = PolygonalLine(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 4.0], [0.0, 4.0], [0.0, 8.0]]))
    x, y = np.meshgrid(np.linspace(-5.0, 15.0, 81), np.linspace(-5.0, 13.0, 73))
    s, d = zigzag.to_road(x, y)
    np.testing.assert_array_equal(np.isnan(s), np.isnan(d))
    # from the inside of a hairpin, whose tangents at both ends of the middle segment are opposed
    hairpin = PolygonalLine(np.array([[0.0, 2.0], [10.0, 0.0], [10.0, 1e-3], [0.0, -2.0]]))
    s, d = hairpin.to_road(x, y)
    np.testing.assert_array_equal(np.isnan(s), np.isnan(d))
