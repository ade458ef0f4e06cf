"""Clusters of points by k-means, their number chosen by silhouette."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Floats


def find_clusters(points: Floats, max_clusters: int) -> NDArray[np.int64]:
    """Return the cluster (F,) of each of F >= 1 points (F, C), counted from the largest."""
    distances = np.sqrt(_compute_squared_distances(points, points))
    candidates = [_run_kmeans(points, k) for k in range(2, min(max_clusters, len(points) - 1) + 1)]
    silhouettes = [_compute_mean_silhouette(distances, labels) for labels in candidates]
    # below this there is one cluster (Kaufman and Rousseeuw 1990: no substantial structure)
    least_silhouette = 0.25
    if max(silhouettes, default=-1.0) < least_silhouette:
        return np.zeros(len(points), dtype=np.int64)
    _, labels, sizes = np.unique(
        candidates[int(np.argmax(silhouettes))], return_inverse=True, return_counts=True
    )
    ranks = np.argsort(np.argsort(-sizes, kind="stable"))
    return np.asarray(ranks[labels])


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
    for _ in range(100):
        nearest = np.argmin(_compute_squared_distances(points, centres), axis=1)
        if (nearest == labels).all():
            break
        labels = nearest
        centres = np.stack(
            [points[labels == j].mean(axis=0) if (labels == j).any() else centres[j] for j in range(k)]
        )
    return labels


def _compute_mean_silhouette(distances: Floats, labels: NDArray[np.int64]) -> float:
    # Mean of (b - a) / max(a, b): a to the point's own cluster, b to the nearest other one.
    clusters, sizes = np.unique(labels, return_counts=True)
    if len(clusters) < 2:
        return -1.0
    member = labels[:, None] == clusters
    sums = distances @ member.astype(float)
    size = member @ sizes
    a = (sums * member).sum(axis=1) / np.maximum(size - 1, 1)
    b = np.where(member, np.inf, sums / sizes).min(axis=1)
    widths = (b - a) / np.maximum(np.maximum(a, b), 1e-300)
    return float(np.where(size == 1, 0.0, widths).mean())
