"""Clusters of failures: k-means on the principal components of their noise, counted by silhouette."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.protocols import Floats

_MAX_CLUSTERS = 6
_COMPONENTS = 5
_OVERSAMPLING, _POWER_ITERATIONS = 10, 12
_BLOCK = 1_000_000
"""Numbers held at once in addition to the tapes."""
_MAX_ITERATIONS = 100
_MIN_SILHOUETTE = 0.25
"""Below this there is one cluster (Kaufman and Rousseeuw 1990: no substantial structure)."""


@dataclass(frozen=True)
class Clusters:
    """Failures sorted into clusters, the largest first.

    Attributes:
        labels: (F,) cluster of each failure.
        medoids: Index of the medoid of each cluster: least total distance to the other members.
        silhouette: Mean silhouette of the clustering; NaN for a single cluster.
    """

    labels: NDArray[np.int64]
    medoids: tuple[int, ...]
    silhouette: float


def cluster(tapes: Sequence[Floats], max_clusters: int = _MAX_CLUSTERS) -> Clusters:
    """Cluster F >= 1 noise tapes of one shape, choosing their number by the mean silhouette.

    Shrunk tapes separate better than raw ones.

    Raises:
        UsageError: There are no tapes, or their shapes differ.
    """
    if not len(tapes):
        raise UsageError("there are no failures to cluster")
    if len({tape.shape for tape in tapes}) > 1:
        text = "failures with noise of different shapes cannot be clustered together"
        raise UsageError(text, "cluster the failures of one scenario")
    points = _compute_principal_components(tapes)
    candidates = [_run_kmeans(points, k) for k in range(2, min(max_clusters, len(points) - 1) + 1)]
    candidates.append(np.zeros(len(points), dtype=np.int64))
    sums = _sum_distances(points, candidates)
    silhouettes = [_compute_mean_silhouette(*pair) for pair in zip(sums[:-1], candidates[:-1], strict=True)]
    best = int(np.argmax(np.nan_to_num(silhouettes, nan=-1.0))) if silhouettes else -1
    if best < 0 or not silhouettes[best] >= _MIN_SILHOUETTE:
        return _sort_by_size(candidates[-1], sums[-1], np.nan)
    return _sort_by_size(candidates[best], sums[best], silhouettes[best])


def _compute_principal_components(tapes: Sequence[Floats]) -> Floats:
    # Coordinates (F, C) along the largest components, by subspace iteration over blocks of tapes: Halko,
    # Martinsson and Tropp, "Finding structure with randomness", SIAM Review 53 (2011), algorithm 4.4.
    size, rows = tapes[0].size, max(_BLOCK // max(tapes[0].size, 1), 1)
    mean = sum(tape.reshape(-1) / len(tapes) for tape in tapes)

    def centred_blocks() -> Iterator[Floats]:
        for begin in range(0, len(tapes), rows):
            yield np.stack([tape.reshape(-1) for tape in tapes[begin : begin + rows]]) - mean

    width = min(_COMPONENTS + _OVERSAMPLING, len(tapes), size)
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((size, width)))[0]
    for _ in range(_POWER_ITERATIONS):
        product = np.zeros((size, width))
        for block in centred_blocks():
            product += block.T @ (block @ basis)
        basis = np.linalg.qr(product)[0]
    coordinates = np.concatenate([block @ basis for block in centred_blocks()])
    left, singular_values, _ = np.linalg.svd(coordinates, full_matrices=False)
    return np.asarray(left[:, :_COMPONENTS] * singular_values[:_COMPONENTS])


def _compute_squared_distances(a: Floats, b: Floats) -> Floats:
    difference = a[:, None] - b[None]
    return np.asarray(np.einsum("abc,abc->ab", difference, difference))


def _run_kmeans(points: Floats, k: int) -> NDArray[np.int64]:
    # Lloyd's algorithm, started from the most central point and the farthest ones
    seeds = [int(np.argmin(_compute_squared_distances(points, points.mean(axis=0)[None])))]
    while len(seeds) < k:
        seeds.append(int(np.argmax(_compute_squared_distances(points, points[seeds]).min(axis=1))))
    centres = points[seeds]
    labels = np.full(len(points), -1)
    for _ in range(_MAX_ITERATIONS):
        nearest = np.argmin(_compute_squared_distances(points, centres), axis=1)
        if (nearest == labels).all():
            break
        labels = nearest
        centres = np.stack(
            [points[labels == j].mean(axis=0) if (labels == j).any() else centres[j] for j in range(k)]
        )
    return labels


def _sum_distances(points: Floats, candidates: Sequence[NDArray[np.int64]]) -> list[Floats]:
    # For each clustering, the summed distances (F, clusters) from each point to each cluster.
    member = np.concatenate([labels[:, None] == np.unique(labels) for labels in candidates], axis=1)
    rows = max(_BLOCK // len(points), 1)
    sums = [
        np.sqrt(_compute_squared_distances(points[begin : begin + rows], points)) @ member.astype(float)
        for begin in range(0, len(points), rows)
    ]
    ends = np.cumsum([len(np.unique(labels)) for labels in candidates])
    return np.split(np.concatenate(sums), ends[:-1], axis=1)


def _compute_mean_silhouette(sums: Floats, labels: NDArray[np.int64]) -> float:
    # Mean of (b - a) / max(a, b): a to the point's own cluster, b to the nearest other one.
    clusters, sizes = np.unique(labels, return_counts=True)
    if len(clusters) < 2:
        return -1.0
    own = labels[:, None] == clusters
    size = (own * sizes).sum(axis=1)
    a = (sums * own).sum(axis=1) / np.maximum(size - 1, 1)
    b = np.where(own, np.inf, sums / sizes).min(axis=1)
    widths = (b - a) / np.maximum(np.maximum(a, b), 1e-300)
    return float(np.where(size == 1, 0.0, widths).mean())


def _sort_by_size(labels: NDArray[np.int64], sums: Floats, silhouette: float) -> Clusters:
    clusters, sizes = np.unique(labels, return_counts=True)
    medoids, renamed = [], np.zeros_like(labels)
    for rank, place in enumerate(np.argsort(-sizes, kind="stable")):
        members = np.flatnonzero(labels == clusters[place])
        medoids.append(int(members[np.argmin(sums[members, place])]))
        renamed[members] = rank
    return Clusters(renamed, tuple(medoids), silhouette)
