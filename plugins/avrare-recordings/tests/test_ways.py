"""Priority of ways through an intersection, case by case."""

import math

import numpy as np
import pytest

from avrare_recordings.roads.ways import Way, prefer

NORTH, WEST, SOUTH, EAST = (0.5 * math.pi * k for k in range(1, 5))
"""Headings at the end of the incoming lane: who drives north comes from the south."""


def way(heading, turn="straight", rank=1, lights=False):
    points = np.array([[0.0, 0.0], [0.0, 1.0]])
    return Way(1, points, points, rank, heading, turn, lights)


@pytest.mark.parametrize(
    ("mine", "other", "reason"),
    [
        (way(NORTH), way(WEST), "right"),
        (way(NORTH), way(EAST), None),
        (way(NORTH), way(NORTH + 0.2 * math.pi), None),  # it merges
        (way(NORTH, rank=0), way(EAST, rank=2), "sign"),
        (way(NORTH, rank=2), way(WEST, rank=0), None),
        (way(NORTH, "left"), way(SOUTH), "oncoming"),
        (way(NORTH, "left"), way(SOUTH, "right"), "oncoming"),
        (way(NORTH, "left"), way(SOUTH, "left"), None),
        (way(NORTH, "right"), way(SOUTH), None),
        (way(NORTH, "left", rank=2), way(SOUTH, rank=0), None),
        # Lights leave oncoming traffic alone its priority, whatever the signs.
        (way(NORTH, lights=True), way(WEST), None),
        (way(NORTH, rank=0, lights=True), way(EAST, rank=2), None),
        (way(NORTH, "left", rank=2, lights=True), way(SOUTH, rank=0), "oncoming"),
        (way(NORTH, "left", rank=0, lights=True), way(SOUTH, rank=2), "oncoming"),
    ],
)
def test_priority(mine, other, reason):
    assert prefer(mine, other) == reason
