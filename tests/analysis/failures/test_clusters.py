"""Clusters of failures."""

import tracemalloc

import numpy as np
import pytest

from avrare.analysis.failures.clusters import _compute_principal_components, cluster
from avrare.base.errors import UsageError


def three_kinds(sizes=(7, 12, 4), noise=0.3):
    rng = np.random.default_rng(0)
    centres = 4.0 * rng.standard_normal((3, 10, 4))
    kinds = np.repeat(np.arange(3), sizes)
    return kinds, [centres[kind] + noise * rng.standard_normal((10, 4)) for kind in kinds]


def test_clusters_are_found_and_the_largest_comes_first():
    kinds, tapes = three_kinds()
    order = np.random.default_rng(1).permutation(len(tapes))
    found = cluster([tapes[k] for k in order])
    expected = np.array([1, 0, 2])[kinds[order]]
    assert found.labels.tolist() == expected.tolist()
    assert found.silhouette > 0.8
    assert [expected[k] for k in found.medoids] == [0, 1, 2]


def test_a_medoid_is_the_most_central_of_its_cluster():
    tapes = [np.full((2, 2), x) for x in (0.0, 0.1, 0.3, 9.0, 9.2, 9.3)]
    found = cluster(tapes)
    assert set(found.medoids) == {1, 4}


def test_tapes_without_structure_are_one_cluster():
    tapes = list(np.random.default_rng(2).standard_normal((40, 30, 5)))
    found = cluster(tapes)
    assert (found.labels == 0).all()
    assert len(found.medoids) == 1
    assert np.isnan(found.silhouette)


def test_there_are_at_most_six_clusters():
    tapes = [np.full((2, 2), 10.0**k * (1 + 0.001 * j)) for k in range(9) for j in range(3)]
    assert len(cluster(tapes).medoids) <= 6
    assert len(cluster(tapes, max_clusters=3).medoids) <= 3


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_or_equal_failures(count):
    found = cluster([np.ones((3, 2))] * count)
    assert found.labels.tolist() == [0] * count
    assert found.medoids == (0,)


def test_blocks_do_not_change_the_clusters(monkeypatch):
    _, tapes = three_kinds(sizes=(9, 30, 14), noise=1.5)
    whole = cluster(tapes)
    monkeypatch.setattr(
        "avrare.analysis.failures.clusters._BLOCK", 100
    )  # of two tapes, and of one row of distances
    parts = cluster(tapes)
    assert parts.labels.tolist() == whole.labels.tolist()
    assert parts.medoids == whole.medoids
    assert parts.silhouette == pytest.approx(whole.silhouette, rel=1e-9)


def test_components_are_the_principal_ones():
    rng = np.random.default_rng(4)
    shared = rng.standard_normal((200, 4)) @ rng.standard_normal((4, 300))
    tapes = (2.0 * shared + rng.standard_normal((200, 300))).reshape(200, 60, 5)
    flat = tapes.reshape(200, -1) - tapes.reshape(200, -1).mean(axis=0)
    left, sizes, _ = np.linalg.svd(flat, full_matrices=False)
    found = _compute_principal_components(list(tapes))
    np.testing.assert_allclose(np.abs(found[:, :4]), np.abs(left[:, :4] * sizes[:4]), rtol=1e-6, atol=1e-8)


def test_memory_does_not_grow_with_the_square_of_the_failures():
    _, tapes = three_kinds(sizes=(900, 700, 400))
    tracemalloc.start()
    found = cluster(tapes)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 150e6  # 2,000 x 2,000 differences of five numbers each would be 160 MB alone, and again
    assert len(found.medoids) == 3


def test_no_failures_and_different_shapes_are_refused():
    with pytest.raises(UsageError, match="no failures"):
        cluster([])
    with pytest.raises(UsageError, match="different shapes"):
        cluster([np.ones((3, 2)), np.ones((3, 3))])
