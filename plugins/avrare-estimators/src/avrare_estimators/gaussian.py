"""Fitting Gaussian laws of the noise tape to weighted elites."""

from __future__ import annotations

import math

import numpy as np

from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare_estimators.config import CeConfig
from avrare_estimators.proposals import Gaussian
from avrare_estimators.sampling import Sample
from avrare_estimators.sources import LatentSource, Source
from avrare_estimators.weights import effective_size

_ROUNDS = 20
"""Of expectation-maximisation."""


class GaussianFamily:
    """Mixtures of Gaussians of the tape; every number has its own mean and standard deviation."""

    def __init__(self, config: CeConfig) -> None:
        self.config = config

    def prepare(self, problem: Problem) -> Problem:
        """Any problem will do."""
        return problem

    def start(self) -> Source:
        """The target itself."""
        return LatentSource(None)

    def watched(self, source: Source) -> Source:
        """Tapes can be drawn again: nothing more is needed."""
        return source

    def fit(self, sample: Sample, rows: Integers, weights: Floats) -> Source:
        """The mixture that fits the rows' tapes, smoothed with the one they came from."""
        tapes = sample.tapes(rows)
        source = sample.source
        old = source.proposal if isinstance(source, LatentSource) else None
        before = old if isinstance(old, Gaussian) else None
        new = mixture(tapes, weights, before, self.config.components, self.config.floor)
        law = _smoothed(before, new, self.config.smoothing)
        return LatentSource(held_back(law, level_nats(sample, self.config.elite)))


def mixture(
    tapes: Floats, weights: Floats, start: Gaussian | None, components: int, floor: float
) -> Gaussian:
    """Weighted maximum likelihood by expectation-maximisation, shrunk to the target.

    Args:
        tapes: (E, steps + 1, noise_size).
        weights: (E,) adding up to 1.
        start: Where to begin; None: components spread out over the tapes.
        components: K.
        floor: Least standard deviation.
    """
    if components == 1:
        return _moments(tapes, weights, np.ones((len(tapes), 1)), floor)
    belongs = _spread(tapes, weights, components) if start is None else _responsibilities(start, tapes)
    law = _moments(tapes, weights, belongs, floor)
    for _ in range(_ROUNDS):
        law = _moments(tapes, weights, _responsibilities(law, tapes), floor)
    return law


def _moments(tapes: Floats, weights: Floats, belongs: Floats, floor: float) -> Gaussian:
    """The law of each component, given how much each tape belongs to it, (E, K)."""
    shares, means, stds = [], [], []
    for mine in (belongs * weights[:, None]).T:
        total = max(float(mine.sum()), 1e-12)
        part = mine / total
        mean = np.einsum("e,etc->tc", part, tapes)
        variance = np.einsum("e,etc->tc", part, (tapes - mean) ** 2)
        many = max(effective_size(mine), 1.0)
        shares.append(total)
        means.append(_significant(mean, variance / many))
        stds.append(np.sqrt(1.0 + _significant(variance - 1.0, 2.0 * variance**2 / many)))
    share = np.array(shares) / np.sum(shares)
    return Gaussian(share, np.stack(means), np.maximum(np.stack(stds), floor))


def _significant(value: Floats, variance: Floats) -> Floats:
    """James and Stein's shrinkage, number by number: what chance explains is left as the target has it.

    A tape has hundreds of numbers and an elite has tens of rows. Without this the errors of the means that do
    not matter add up, and the weights degenerate.
    """
    return value * np.maximum(0.0, 1.0 - variance / np.maximum(value * value, 1e-300))


def held_back(law: Gaussian, nats: float) -> Gaussian:
    """The law with means and log standard deviations scaled until no component is more than ``nats`` away.

    A law under which an event of probability p is likely need differ from the target by no more than -log p
    nats. What goes beyond is the noise of a small elite.
    """
    scale = np.ones(len(law.share))
    for _ in range(_ROUNDS):
        mean, log_std = (scale[:, None, None] * part for part in (law.mean, np.log(law.std)))
        far = 0.5 * (mean**2 + np.expm1(2.0 * log_std) - 2.0 * log_std).sum(axis=(1, 2))
        scale = scale * np.sqrt(np.minimum(1.0, nats / np.maximum(far, 1e-300)))
    wide = scale[:, None, None]
    return Gaussian(law.share, wide * law.mean, np.exp(wide * np.log(law.std)))


def level_nats(sample: Sample, elite: float) -> float:
    """-log of the probability of the level that a sample has reached, each stage's elite being a share."""
    return -(sample.parts[0].stage + 1) * math.log(elite)


def _responsibilities(law: Gaussian, tapes: Floats) -> Floats:
    """(E, K) probability that each tape is of each component."""
    logs = np.log(law.share) + law.component_log_ratios(tapes)
    grown = np.exp(logs - logs.max(axis=1, keepdims=True))
    return np.asarray(grown / grown.sum(axis=1, keepdims=True))


def _spread(tapes: Floats, weights: Floats, components: int) -> Floats:
    """(E, K) first assignment: centres far apart, each tape to the nearest."""
    flat = tapes.reshape(len(tapes), -1)
    centres = [flat[int(np.argmax(weights))]]
    distance = ((flat - centres[0]) ** 2).sum(axis=1)
    for _ in range(components - 1):
        centres.append(flat[int(np.argmax(distance))])
        distance = np.minimum(distance, ((flat - centres[-1]) ** 2).sum(axis=1))
    to_each = np.stack([((flat - centre) ** 2).sum(axis=1) for centre in centres], axis=1)
    return np.asarray(to_each.argmin(axis=1)[:, None] == np.arange(components), dtype=np.float64)


def _smoothed(old: Gaussian | None, new: Gaussian, weight: float) -> Gaussian:
    """``weight`` parts new, the rest old (the target before the first stage)."""
    if old is None:
        old = Gaussian(new.share, np.zeros_like(new.mean), np.ones_like(new.std))
    mixed = [weight * b + (1.0 - weight) * a for a, b in zip(_numbers(old), _numbers(new), strict=True)]
    return Gaussian(mixed[0] / mixed[0].sum(), mixed[1], mixed[2])


def _numbers(law: Gaussian) -> tuple[Floats, Floats, Floats]:
    return law.share, law.mean, law.std
