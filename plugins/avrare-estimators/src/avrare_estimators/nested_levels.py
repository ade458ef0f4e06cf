"""Nested levels: where the next one lies, who goes on from it, and how sure a level's share is.

A level's set holds the failures and what lies strictly above the level. The level itself is an order
statistic of a run's samples, the largest of those that shall not survive; the factor is the share that
really does, ties and all. Sets are nested by construction, whatever the score says of failures.
"""

from __future__ import annotations

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers


def next_levels(key: Floats, survivors: int) -> tuple[Floats, Bools]:
    """The next level of each run, and whether there is one.

    There is none where at least ``survivors`` samples fail, or where no sample lies above the others.

    Args:
        key: (A, N) of samples, see ``Points.key``; failures are inf.
        survivors: How many shall lie above the level; more on ties.

    Returns:
        (A,) levels and (A,) bool.
    """
    ordered = np.sort(key, axis=1)
    cut = ordered[:, -survivors]
    below = ordered < cut[:, None]
    count = below.sum(axis=1)
    largest_below = np.take_along_axis(ordered, np.maximum(count - 1, 0)[:, None], axis=1)[:, 0]
    level = np.where(count > 0, largest_below, cut)
    return level, (cut < np.inf) & (level < ordered[:, -1])


def choose_seeds(alive: Bools, many: int, uniforms: Floats) -> Integers:
    """``many`` of each run's survivors, each equally often in the mean (systematic resampling).

    Args:
        alive: (A, N) at least one in each run.
        many: C.
        uniforms: (A,) in (0, 1).

    Returns:
        (A, C) columns of ``alive``.
    """
    count = alive.sum(axis=1)
    first = np.argsort(~alive, axis=1, kind="stable")
    place = (np.arange(many) + uniforms[:, None]) * count[:, None] / many
    pick = np.minimum(place.astype(np.int64), count[:, None] - 1)
    return np.asarray(np.take_along_axis(first, pick, axis=1))


def relative_weights(log_weight: Floats) -> Floats:
    """Weights (A, N) of mean 1, of their logs (A, N) up to a constant for each row; 0 where all are 0."""
    largest = log_weight.max(axis=1, keepdims=True)
    weights = np.exp(log_weight - np.where(np.isfinite(largest), largest, 0.0))
    mean = weights.mean(axis=1, keepdims=True)
    return np.asarray(weights / np.where(mean > 0.0, mean, 1.0))


def effective_size(hit: Bools, weights: Floats | None = None) -> Floats:
    """Independent samples (A,) worth as much as the chains' for the share of hits.

    From the scatter of the chains' means; chains that share ancestors are worth less than it says.

    Args:
        hit: (A, P, C) whether sample p of chain c is one.
        weights: (A, P, C) of mean 1; None: all the same.
    """
    samples, chains = hit.shape[1] * hit.shape[2], hit.shape[2]
    if weights is None:
        share = hit.mean(axis=(1, 2))
        scatter = hit.mean(axis=1).var(axis=1, ddof=1) / chains
    else:  # a ratio of means, to first order
        share = (weights * hit).mean(axis=(1, 2))
        off = (weights * (hit - share[:, None, None])).mean(axis=1)
        scatter = off.var(axis=1, ddof=1) / chains
    size = share * (1.0 - share) / np.where(scatter > 0.0, scatter, 1.0)
    return np.asarray(np.where(scatter > 0.0, np.minimum(size, samples), samples))


def r_hat(values: Floats) -> Floats:
    """Gelman and Rubin's ratio (A,): 1 where chains have forgotten where they started.

    Args:
        values: (A, P, C) sample p of chain c, finite.
    """
    length = values.shape[1]
    within = values.var(axis=1, ddof=1).mean(axis=1)
    between = values.mean(axis=1).var(axis=1, ddof=1)
    excess = between / np.where(within > 0.0, within, 1.0)
    forgotten = np.where(between > 0.0, np.inf, 1.0)
    return np.asarray(np.where(within > 0.0, np.sqrt((length - 1.0) / length + excess), forgotten))
