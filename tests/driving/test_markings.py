"""Lines on roads, for pictures."""

import numpy as np
import pytest

from avrare.driving import Lane, Road
from avrare.driving.lanes import ENDLESS, list_markings


def lane(begin, end, right, left):
    return Lane(np.array([begin, end]), np.full(2, right), np.full(2, left))


def told(road):
    """Return (from x, to x, from y, to y, inner) of each line."""
    return sorted((*map(float, one.x[[0, -1]]), *map(float, one.y[[0, -1]]), one.inner)
                  for one in list_markings(road))  # fmt: skip


def test_parallel_lanes_share_their_inner_borders():
    ends = -ENDLESS, ENDLESS
    assert told(Road((-1.75, 1.75), 3.5)) == [
        (*ends, -3.5, -3.5, False), (*ends, 0.0, 0.0, True), (*ends, 3.5, 3.5, False),
    ]  # fmt: skip


def test_lanes_apart_have_borders_of_their_own():
    assert [one[2:] for one in told(Road((0.0, 10.0), 3.0))] == [
        (-1.5, -1.5, False), (1.5, 1.5, False), (8.5, 8.5, False), (11.5, 11.5, False),
    ]  # fmt: skip


def test_a_lane_that_ends_leaves_an_edge_and_a_line_across_its_end():
    road = Road((-1.5, 1.5), 3.0, begin=0.0, end=200.0,
                lanes=(lane(-ENDLESS, 120.0, -3.0, 0.0), lane(-ENDLESS, ENDLESS, 0.0, 3.0)))  # fmt: skip
    assert told(road) == [
        (-ENDLESS, 120.0, -3.0, -3.0, False),
        (-ENDLESS, 120.0, 0.0, 0.0, True),
        (-ENDLESS, ENDLESS, 3.0, 3.0, False),
        (120.0, 120.0, -3.0, 0.0, False),
        (120.0, ENDLESS, 0.0, 0.0, False),
    ]


@pytest.mark.parametrize(("after", "across"), [(80.0, 0), (85.0, 2)])
def test_a_lane_that_another_one_continues_has_no_line_across(after, across):
    road = Road((0.0, 0.1), 3.0, begin=0.0, end=200.0,
                lanes=(lane(0.0, 80.0, -1.5, 1.5), lane(after, 200.0, -1.4, 1.6)))  # fmt: skip
    assert sum(one[0] == one[1] for one in told(road)) == across


def test_borders_that_part_are_shared_as_far_as_they_touch():
    road = Road((-1.5, 1.5), 3.0, begin=0.0, end=200.0, lanes=(
        Lane(np.array([0.0, 50.0, 100.0]), np.full(3, -3.0), np.array([0.0, 0.0, -2.0])),
        lane(0.0, 100.0, 0.0, 3.0),
    ))  # fmt: skip
    assert [(*one[:2], one[4]) for one in told(road) if one[0] in (0.0, 50.0) and one[2] > -3.0] == [
        (0.0, 50.0, True), (0.0, 100.0, False), (50.0, 100.0, False), (50.0, 100.0, False),
    ]  # fmt: skip


def test_where_a_lane_merges_into_another_no_line_is_within_either():
    ramp = Lane(np.array([0.0, 40.0, 80.0]), np.array([-9.0, -6.0, -3.0]), np.array([-6.0, -3.0, 0.0]))
    road = Road((-4.0, -1.5), 3.0, begin=0.0, end=200.0, lanes=(ramp, lane(0.0, 200.0, -3.0, 0.0)))
    assert told(road) == [
        (0.0, 40.0, -6.0, -3.0, False),
        (0.0, 40.0, -3.0, -3.0, False),
        (0.0, 80.0, -9.0, -3.0, False),
        (0.0, 200.0, 0.0, 0.0, False),
        (80.0, 200.0, -3.0, -3.0, False),
    ]
