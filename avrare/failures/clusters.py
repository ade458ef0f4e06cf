"""Kinds of failures: k-means on the principal components of their noise, as many as silhouettes show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare.protocols import Floats

MOST = 6
"""Kinds at most."""
_COMPONENTS = 5
_SPARE, _PASSES = 10, 12
"""Of the subspace iteration: more components than are wanted, and how often the tapes are gone through."""
_BLOCK = 1_000_000
"""Numbers that are held at once beside the tapes."""
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
    points = _components(tapes)
    sortings = [_kmeans(points, count) for count in range(2, min(most, len(points) - 1) + 1)]
    sortings.append(np.zeros(len(points), dtype=np.int64))
    totals = _totals(points, sortings)
    best, silhouette = len(sortings) - 1, np.nan
    for number, labels in enumerate(sortings[:-1]):
        found = _silhouette(totals[number], labels)
        if found >= _LEAST_SILHOUETTE and not found <= silhouette:
            best, silhouette = number, found
    return _ordered(sortings[best], totals[best], silhouette)


def _components(tapes: Sequence[Floats]) -> Floats:
    """(F, C) coordinates along the largest principal components, by subspace iteration over blocks of tapes.

    Halko, Martinsson and Tropp, "Finding structure with randomness", SIAM Review 53 (2011), algorithm 4.4.
    """
    size, rows = tapes[0].size, max(_BLOCK // max(tapes[0].size, 1), 1)
    mean = sum(tape.reshape(-1) / len(tapes) for tape in tapes)

    def centred() -> Iterator[Floats]:
        for begin in range(0, len(tapes), rows):
            yield np.stack([tape.reshape(-1) for tape in tapes[begin : begin + rows]]) - mean

    width = min(_COMPONENTS + _SPARE, len(tapes), size)
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((size, width)))[0]
    for _ in range(_PASSES):
        product = np.zeros((size, width))
        for block in centred():
            product += block.T @ (block @ basis)
        basis = np.linalg.qr(product)[0]
    coordinates = np.concatenate([block @ basis for block in centred()])
    left, sizes, _ = np.linalg.svd(coordinates, full_matrices=False)
    return np.asarray(left[:, :_COMPONENTS] * sizes[:_COMPONENTS])


def _squares(a: Floats, b: Floats) -> Floats:
    difference = a[:, None] - b[None]
    return np.asarray(np.einsum("abc,abc->ab", difference, difference))


def _kmeans(points: Floats, count: int) -> NDArray[np.int64]:
    """(F,) labels by Lloyd's rounds from centres far apart: the middlemost point, then the farthest ones."""
    chosen = [int(np.argmin(_squares(points, points.mean(axis=0)[None])))]
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


def _totals(points: Floats, sortings: Sequence[NDArray[np.int64]]) -> list[Floats]:
    """For each sorting, (F, kinds) summed distances from each point to those of each kind."""
    member = np.concatenate([labels[:, None] == np.unique(labels) for labels in sortings], axis=1)
    rows = max(_BLOCK // len(points), 1)
    sums = [
        np.sqrt(_squares(points[begin : begin + rows], points)) @ member.astype(float)
        for begin in range(0, len(points), rows)
    ]
    ends = np.cumsum([len(np.unique(labels)) for labels in sortings])
    return np.split(np.concatenate(sums), ends[:-1], axis=1)


def _silhouette(totals: Floats, labels: NDArray[np.int64]) -> float:
    """Mean of (b - a) / max(a, b): a the mean distance to one's own kind, b to the nearest other one."""
    kinds, sizes = np.unique(labels, return_counts=True)
    if len(kinds) < 2:
        return -1.0
    own = labels[:, None] == kinds
    size = (own * sizes).sum(axis=1)
    a = (totals * own).sum(axis=1) / np.maximum(size - 1, 1)
    b = np.where(own, np.inf, totals / sizes).min(axis=1)
    widths = (b - a) / np.maximum(np.maximum(a, b), 1e-300)
    return float(np.where(size == 1, 0.0, widths).mean())


def _ordered(labels: NDArray[np.int64], totals: Floats, silhouette: float) -> Clusters:
    kinds, sizes = np.unique(labels, return_counts=True)
    medoids, renamed = [], np.zeros_like(labels)
    for rank, place in enumerate(np.argsort(-sizes, kind="stable")):
        members = np.flatnonzero(labels == kinds[place])
        medoids.append(int(members[np.argmin(totals[members, place])]))
        renamed[members] = rank
    return Clusters(renamed, tuple(medoids), silhouette)
