"""Kinds of failures: k-means on the principal components of their noise, as many as silhouettes show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare.protocols import Floats

MOST = 6
"""Kinds at most."""
_COMPONENTS = 5
_ROUNDS = 100
_LEAST_SILHOUETTE = 0.25
"""Below, the failures are of one kind (Kaufman and Rousseeuw 1990: no substantial structure)."""


@dataclass(frozen=True)
class Clusters:
    """Failures sorted into kinds, the most frequent first.

    Attributes:
        labels: (F,) kind of each failure.
        medoids: For each kind, the failure with the least distance to all others of its kind.
        silhouette: Mean silhouette of the sorting; NaN where there is one kind.
    """

    labels: NDArray[np.int64]
    medoids: tuple[int, ...]
    silhouette: float


def cluster(tapes: Sequence[Floats], most: int = MOST) -> Clusters:
    """Sort noise tapes of one shape into kinds.

    Args:
        tapes: F of them, at least one; shrunk ones tell more than raw ones.
        most: Kinds at most.

    Raises:
        UsageError: There is none, or they have several shapes.
    """
    if not len(tapes):
        raise UsageError("there are no failures to sort")
    if len({tape.shape for tape in tapes}) > 1:
        raise UsageError("failures of several shapes cannot be sorted together", "sort those of one scenario")
    points = _components(np.stack([tape.reshape(-1) for tape in tapes]))
    distances = np.sqrt(_squares(points, points))
    best, silhouette = np.zeros(len(points), dtype=np.int64), np.nan
    for count in range(2, min(most, len(points) - 1) + 1):
        labels = _kmeans(points, count)
        found = _silhouette(distances, labels)
        if found >= _LEAST_SILHOUETTE and not found <= silhouette:
            best, silhouette = labels, found
    return _ordered(best, distances, silhouette)


def _components(tapes: Floats) -> Floats:
    """(F, C) coordinates along the largest principal components."""
    centred = tapes - tapes.mean(axis=0)
    left, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    return np.asarray(left[:, :_COMPONENTS] * sizes[:_COMPONENTS])


def _squares(a: Floats, b: Floats) -> Floats:
    difference = a[:, None] - b[None]
    return np.asarray(np.einsum("abc,abc->ab", difference, difference))


def _kmeans(points: Floats, count: int) -> NDArray[np.int64]:
    """(F,) labels by Lloyd's rounds from centres far apart: the middlemost point, then the farthest ones."""
    chosen = [int(np.argmin(_squares(points, points).sum(axis=1)))]
    while len(chosen) < count:
        chosen.append(int(np.argmax(_squares(points, points[chosen]).min(axis=1))))
    centres = points[chosen]
    labels = np.full(len(points), -1)
    for _ in range(_ROUNDS):
        now = np.argmin(_squares(points, centres), axis=1)
        if (now == labels).all():
            break
        labels = now
        centres = np.stack(
            [points[labels == k].mean(axis=0) if (labels == k).any() else centres[k] for k in range(count)]
        )
    return labels


def _silhouette(distances: Floats, labels: NDArray[np.int64]) -> float:
    """Mean of (b - a) / max(a, b): a the mean distance to one's own kind, b to the nearest other one."""
    kinds = np.unique(labels)
    if len(kinds) < 2:
        return -1.0
    member = (labels[None] == kinds[:, None]).astype(float)
    total = np.einsum("fg,kg->kf", distances, member)
    sizes = member.sum(axis=1)[:, None]
    own = member.astype(bool)
    alone = (sizes * member).sum(axis=0) == 1
    a = (total * member).sum(axis=0) / np.maximum((sizes * member).sum(axis=0) - 1, 1)
    b = np.where(own, np.inf, total / sizes).min(axis=0)
    widths = (b - a) / np.maximum(np.maximum(a, b), 1e-300)
    return float(np.where(alone, 0.0, widths).mean())


def _ordered(labels: NDArray[np.int64], distances: Floats, silhouette: float) -> Clusters:
    kinds, sizes = np.unique(labels, return_counts=True)
    ranked = kinds[np.argsort(-sizes, kind="stable")]
    medoids, renamed = [], np.zeros_like(labels)
    for rank, kind in enumerate(ranked):
        members = np.flatnonzero(labels == kind)
        medoids.append(int(members[np.argmin(distances[np.ix_(members, members)].sum(axis=1))]))
        renamed[members] = rank
    return Clusters(renamed, tuple(medoids), silhouette)
