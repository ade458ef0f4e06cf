"""Lanes of a road: borders, overlap, the outermost one; vehicles between the road's frame and the plane."""

import numpy as np

from avrare.driving import Lane, Road, Vehicles
from avrare.driving.lanes import is_outermost, lane_borders, lane_exists, lane_overlap
from avrare.driving.reference_line import CurvedLine, Piece
from avrare.driving.values import to_plane, to_road

ENDING = Lane(np.array([0.0, 50.0]), np.array([-5.0, -2.0]), np.array([-1.75, -1.75]))
MAIN = Lane(np.array([0.0, 200.0]), np.array([-1.75, -1.75]), np.array([1.75, 2.25]))
ROAD = Road((-3.4, 0.1), 3.5, lanes=(ENDING, MAIN))


class TestLanes:
    def test_borders_vary_and_keep_their_last_value(self):
        right, left = lane_borders(ROAD, np.array([-10.0, 25.0, 300.0]))
        np.testing.assert_allclose(right[0], [-5.0, -3.5, -2.0])
        np.testing.assert_allclose(left[1], [1.75, 1.8125, 2.25])

    def test_a_lane_that_ends_bounds_along_the_road(self):
        x, y = np.array([40.0, 52.0, 60.0]), np.full(3, -2.2)
        found = lane_overlap(ROAD, x, y, np.full(3, 2.5), np.full(3, 0.9))
        np.testing.assert_allclose(found[0], [1.3, 0.5, -7.5])

    def test_parallel_lanes_are_the_same_in_either_form(self):
        plain = Road((-1.75, 1.75), 3.5)
        borders = (np.full(2, -3.5), np.zeros(2)), (np.zeros(2), np.full(2, 3.5))
        lanes = tuple(Lane(np.array([-1e3, 1e3]), *both) for both in borders)
        rng = np.random.default_rng(0)
        box = (rng.uniform(-50, 50, 30), rng.uniform(-6, 6, 30), np.full(30, 2.5), np.full(30, 0.9))
        varying = lane_overlap(Road((-1.75, 1.75), 3.5, lanes=lanes), *box)
        np.testing.assert_allclose(lane_overlap(plain, *box), varying, atol=1e-12)

    def test_outermost_changes_where_a_lane_ends(self):
        x = np.array([10.0, 100.0, 500.0])
        np.testing.assert_array_equal(lane_exists(ROAD, x), [[True, False, False], [True, True, False]])
        outermost = is_outermost(ROAD, (0, 1), x, -1.0)
        np.testing.assert_array_equal(outermost, [[True, False, False], [False, True, False]])
        np.testing.assert_array_equal(is_outermost(ROAD, (1,), x, -1.0)[1], [True, True, False])


class TestFrames:
    LINE = CurvedLine((Piece(100.0, 0.01, 0.01),))

    def vehicles(self, rng):
        shape = (5, 3)
        parts = rng.uniform(0, 90, shape), rng.uniform(-5, 5, shape), rng.uniform(-0.2, 0.2, shape)
        return Vehicles(*parts, rng.uniform(5, 20, shape), np.zeros(shape))

    def test_there_and_back(self):
        vehicles = self.vehicles(np.random.default_rng(4))
        again = to_road(self.LINE, to_plane(Road((0.0,), 3.5, line=self.LINE), vehicles))
        for name in ("x", "y", "heading", "speed"):
            np.testing.assert_allclose(getattr(again, name), getattr(vehicles, name), atol=1e-10)

    def test_a_straight_road_keeps_every_bit(self):
        vehicles = self.vehicles(np.random.default_rng(4))
        assert to_plane(Road((0.0,), 3.5), vehicles) is vehicles
