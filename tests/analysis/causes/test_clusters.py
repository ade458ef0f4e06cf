"""Clusters of points: their labels, and how many there are."""

import numpy as np
import pytest

from avrare.analysis.causes.clusters import find_clusters


def test_clusters_are_found_and_the_largest_comes_first():
    rng = np.random.default_rng(0)
    centres = 4.0 * rng.standard_normal((3, 40))
    kinds = rng.permutation(np.repeat(np.arange(3), (7, 12, 4)))
    points = centres[kinds] + 0.3 * rng.standard_normal((len(kinds), 40))
    assert find_clusters(points, 6).tolist() == np.array([1, 0, 2])[kinds].tolist()


def test_points_without_structure_are_one_cluster():
    points = np.random.default_rng(2).standard_normal((40, 150))
    assert (find_clusters(points, 6) == 0).all()


def test_there_are_no_more_clusters_than_wanted():
    points = np.array([[10.0**k * (1 + 0.001 * j)] for k in range(9) for j in range(3)])
    assert [len(np.unique(find_clusters(points, count))) for count in (1, 2, 3, 6)] == [1, 2, 3, 4]


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_or_equal_points_are_one_cluster(count):
    assert find_clusters(np.ones((count, 6)), 6).tolist() == [0] * count
