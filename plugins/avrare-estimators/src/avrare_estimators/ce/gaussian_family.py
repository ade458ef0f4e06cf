"""Gaussian family of cross-entropy: laws of the noise tape fitted to weighted elites."""

from __future__ import annotations

import math

import numpy as np

from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare_estimators.ce.config import GaussianFamilyConfig
from avrare_estimators.common.samples.sampling import Sample
from avrare_estimators.common.samples.sources import LatentSource, Source
from avrare_estimators.common.tapes.gaussian_mixture import GaussianMixture
from avrare_estimators.common.weights import effective_size

_MOST_COMPONENTS, _ROWS_OF_COMPONENT = 4, 100
_ROUNDS = 20
"""Rounds of expectation-maximisation, and of scaling back."""


class GaussianFamily:
    """Mixtures of Gaussians of the tape; every number has its own mean and standard deviation."""

    def __init__(self, options: GaussianFamilyConfig, elite: float) -> None:
        self.options, self.elite = options, elite

    def prepare(self, problem: Problem) -> Problem:
        """Return the problem unchanged: any will do."""
        return problem

    def start(self) -> Source:
        """Return the target itself."""
        return LatentSource(None)

    def with_details(self, source: Source) -> Source:
        """Return the source: its tapes can be drawn again, and nothing more is needed."""
        return source

    def fit(self, sample: Sample, rows: Integers, weights: Floats) -> Source:
        """Return the mixture that fits the rows' tapes, smoothed with the one they came from."""
        tapes = sample.tapes(rows)
        source = sample.source
        proposal = source.proposal if isinstance(source, LatentSource) else None
        old = proposal if isinstance(proposal, GaussianMixture) else None
        wanted = self.options.components or default_components(len(rows))
        components = wanted if old is None else len(old.share)
        new = fit_mixture(tapes, weights, old, components, self.options.floor)
        law = _smooth(old, new, self.options.smoothing)
        return LatentSource(limit_divergence(law, most_nats(sample, self.elite)))


def default_components(rows: int) -> int:
    """Return the number of Gaussians to fit to so many tapes: few of them fit one better than several."""
    return int(np.clip(rows // _ROWS_OF_COMPONENT, 1, _MOST_COMPONENTS))


def fit_mixture(
    tapes: Floats, weights: Floats, start: GaussianMixture | None, components: int, floor: float
) -> GaussianMixture:
    """Fit a mixture by expectation-maximisation of the weighted likelihood, shrunk to the target.

    Args:
        tapes: (E, steps + 1, noise_size).
        weights: (E,) adding up to 1.
        start: First mixture; None: components spread out over the tapes.
        components: K.
        floor: Least standard deviation.
    """
    if components == 1:
        return _fit_components(tapes, weights, np.ones((len(tapes), 1)), floor)
    belongs = (
        _assign_to_centres(tapes, weights, components) if start is None else _responsibilities(start, tapes)
    )
    law = _fit_components(tapes, weights, belongs, floor)
    for _ in range(_ROUNDS):
        law = _fit_components(tapes, weights, _responsibilities(law, tapes), floor)
    return law


def _fit_components(tapes: Floats, weights: Floats, belongs: Floats, floor: float) -> GaussianMixture:
    shares, means, stds = [], [], []
    for row_weights in (belongs * weights[:, None]).T:
        total = max(float(row_weights.sum()), 1e-12)
        normed = row_weights / total
        mean = np.einsum("e,etc->tc", normed, tapes)
        variance = np.einsum("e,etc->tc", normed, (tapes - mean) ** 2)
        size = max(effective_size(row_weights), 1.0)
        shares.append(total)
        means.append(_shrink_to_zero(mean, variance / size))
        stds.append(np.sqrt(1.0 + _shrink_to_zero(variance - 1.0, 2.0 * variance**2 / size)))
    share = np.array(shares) / np.sum(shares)
    return GaussianMixture(share, np.stack(means), np.maximum(np.stack(stds), floor))


def _shrink_to_zero(value: Floats, variance: Floats) -> Floats:
    """Apply James and Stein's shrinkage, number by number, towards the target's 0.

    A tape has hundreds of numbers and an elite has tens of rows. Without shrinkage the errors of the means
    that do not matter add up, and the weights degenerate.
    """
    return value * np.maximum(0.0, 1.0 - variance / np.maximum(value * value, 1e-300))


def limit_divergence(law: GaussianMixture, nats: float) -> GaussianMixture:
    """Scale means and log standard deviations until no component diverges by more than ``nats``.

    A law under which an event of probability p is likely need differ from the target by no more than -log p
    nats. Any further divergence is the noise of a small elite.
    """
    scale = np.ones(len(law.share))
    for _ in range(_ROUNDS):
        mean, log_std = (scale[:, None, None] * part for part in (law.mean, np.log(law.std)))
        divergence = 0.5 * (mean**2 + np.expm1(2.0 * log_std) - 2.0 * log_std).sum(axis=(1, 2))
        scale = scale * np.sqrt(np.minimum(1.0, nats / np.maximum(divergence, 1e-300)))
    wide = scale[:, None, None]
    return GaussianMixture(law.share, wide * law.mean, np.exp(wide * np.log(law.std)))


def most_nats(sample: Sample, elite: float) -> float:
    """Return -log of the probability of the level that a sample has reached, each elite being a share."""
    return -(sample.strata[0].stage + 1) * math.log(elite)


def _responsibilities(law: GaussianMixture, tapes: Floats) -> Floats:
    logs = np.log(law.share) + law.component_log_ratios(tapes)
    grown = np.exp(logs - logs.max(axis=1, keepdims=True))
    return np.asarray(grown / grown.sum(axis=1, keepdims=True))


def _assign_to_centres(tapes: Floats, weights: Floats, components: int) -> Floats:
    flat = tapes.reshape(len(tapes), -1)
    centres = [flat[int(np.argmax(weights))]]
    distance = ((flat - centres[0]) ** 2).sum(axis=1)
    for _ in range(components - 1):
        centres.append(flat[int(np.argmax(distance))])
        distance = np.minimum(distance, ((flat - centres[-1]) ** 2).sum(axis=1))
    to_each = np.stack([((flat - centre) ** 2).sum(axis=1) for centre in centres], axis=1)
    return np.asarray(to_each.argmin(axis=1)[:, None] == np.arange(components), dtype=np.float64)


def _smooth(old: GaussianMixture | None, new: GaussianMixture, weight: float) -> GaussianMixture:
    """Return ``weight`` parts new, the rest old (the target before the first stage)."""
    if old is None:
        old = GaussianMixture(new.share, np.zeros_like(new.mean), np.ones_like(new.std))
    pairs = ((old.share, new.share), (old.mean, new.mean), (old.std, new.std))
    share, mean, std = (weight * b + (1.0 - weight) * a for a, b in pairs)
    return GaussianMixture(share / share.sum(), mean, std)
