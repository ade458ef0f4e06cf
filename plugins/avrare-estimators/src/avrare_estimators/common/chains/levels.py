"""Nested levels: the next level, the seeds of its chains, and the accuracy of a level's share.

A level's set holds the failures and the tapes that lie strictly above the level. The level itself is an order
statistic of a run's samples, the largest of those that shall not survive; the factor is the share that
really survives, ties included. Sets are nested by construction, whatever the scores of failures are.
"""

from __future__ import annotations

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers


def next_levels(key: Floats, survivors: int) -> tuple[Floats, Bools]:
    """Return the next level of each run, and whether there is one.

    There is none where at least ``survivors`` samples fail, or where no sample lies above the others.

    Args:
        key: (A, N) keys of the samples, see ``Points.key``; failures are inf.
        survivors: Number of samples that shall lie above the level; more on ties.

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


def choose_seeds(alive: Bools, chains: int, uniforms: Floats) -> Integers:
    """Choose seeds among each run's survivors, each equally often in the mean (systematic resampling).

    Args:
        alive: (A, N) at least one in each run.
        chains: C.
        uniforms: (A,) in (0, 1).

    Returns:
        (A, C) columns of ``alive``.
    """
    count = alive.sum(axis=1)
    first = np.argsort(~alive, axis=1, kind="stable")
    place = (np.arange(chains) + uniforms[:, None]) * count[:, None] / chains
    pick = np.minimum(place.astype(np.int64), count[:, None] - 1)
    return np.asarray(np.take_along_axis(first, pick, axis=1))


def relative_weights(log_weight: Floats) -> Floats:
    """Return weights (A, N) of mean 1 from logs that are known up to a constant of each row.

    A row without any weight gives zeros.
    """
    largest = log_weight.max(axis=1, keepdims=True)
    weights = np.exp(log_weight - np.where(np.isfinite(largest), largest, 0.0))
    mean = weights.mean(axis=1, keepdims=True)
    return np.asarray(weights / np.where(mean > 0.0, mean, 1.0))


def effective_samples(hit: Bools, weights: Floats | None = None) -> Floats:
    """Return the number (A,) of independent samples that would give the share of hits as accurately.

    It comes from the scatter of the chains' means; chains that share ancestors are worth less.

    Args:
        hit: (A, P, C) sample p of chain c is a hit.
        weights: (A, P, C) of mean 1; None: all equal.
    """
    samples, chains = hit.shape[1] * hit.shape[2], hit.shape[2]
    if weights is None:
        share = hit.mean(axis=(1, 2))
        scatter = hit.mean(axis=1).var(axis=1, ddof=1) / chains
    else:  # a ratio of means, to first order
        share = (weights * hit).mean(axis=(1, 2))
        deviation = (weights * (hit - share[:, None, None])).mean(axis=1)
        scatter = deviation.var(axis=1, ddof=1) / chains
    size = share * (1.0 - share) / np.where(scatter > 0.0, scatter, 1.0)
    return np.asarray(np.where(scatter > 0.0, np.minimum(size, samples), samples))


def r_hat(values: Floats) -> Floats:
    """Return the ratio (A,) of Gelman and Rubin: 1 where chains no longer depend on their starts.

    Args:
        values: (A, P, C) sample p of chain c, finite.
    """
    length = values.shape[1]
    within = values.var(axis=1, ddof=1).mean(axis=1)
    between = values.mean(axis=1).var(axis=1, ddof=1)
    excess = between / np.where(within > 0.0, within, 1.0)
    constant = np.where(between > 0.0, np.inf, 1.0)
    return np.asarray(np.where(within > 0.0, np.sqrt((length - 1.0) / length + excess), constant))
