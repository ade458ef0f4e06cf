"""Learned potentials: how much more likely a rollout's future is to fail than at the start.

With q_l(x) the learned probability of reaching level l from features x, and p_l that of reaching it at all,
h(x) = a0 + sum_l a_l q_l(x) / p_l. Particles are copied in proportion to h: the twisting functions of
Whiteley and Lee (2014) and Guarniero et al. (2017). Any positive h leaves the estimate unbiased.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers
from avrare_estimators.common.weights import effective_size
from avrare_estimators.smc.network import Examples, Network, fit

_LEAST_HITS = 15.0
"""Effective rollouts beyond a level that is learnt."""


@dataclass(frozen=True)
class Paths:
    """Rollouts of one learning stage.

    Attributes:
        features: (n, K, F) at each step of the schedule; the last one is the running score.
        score: (n,) final score.
        violated: (n,) the rollout fails.
        weights: (n,) their mean over a set estimates its probability.
        root: (n,) first ancestor.
    """

    features: Floats
    score: Floats
    violated: Bools
    weights: Floats
    root: Integers

    @staticmethod
    def join(stages: Sequence[Paths]) -> Paths:
        """Pool stages; each counts with its number of roots."""
        if len(stages) == 1:
            return stages[0]
        counts = np.array([len(np.unique(stage.root)) for stage in stages])
        shares = counts / counts.sum()
        total = sum(len(stage.score) for stage in stages)
        weights = [
            share * total / len(stage.score) * stage.weights
            for share, stage in zip(shares, stages, strict=True)
        ]
        return Paths(
            np.concatenate([stage.features for stage in stages]),
            np.concatenate([stage.score for stage in stages]),
            np.concatenate([stage.violated for stage in stages]),
            np.concatenate(weights),
            np.concatenate([stage.root for stage in stages]),
        )


@dataclass(frozen=True)
class Potentials:
    """Potentials at some steps of a rollout.

    Attributes:
        network: Network for all steps of the schedule.
        gains: (K,) gain of the potential at each step of the schedule, in nats, on rollouts held out.
        levels: (L,) score of each level; inf stands for failure.
        chances: (L,) probability of reaching each.
    """

    network: Network
    gains: Floats
    levels: Floats
    chances: Floats

    @property
    def useful(self) -> list[int]:
        """Numbers of the scheduled steps at which the potential has a gain."""
        return [int(k) for k in np.flatnonzero(self.gains >= 0.1)]  # a smaller gain is not worth resampling

    @property
    def reached(self) -> bool:
        """True where the deepest level is failure."""
        return bool(np.isinf(self.levels[-1]))

    def __call__(self, step: int, features: Floats) -> Floats:
        """Return h (n,) at scheduled step number ``step``."""
        reached = self.network.probabilities(step, features)
        reached = np.where(features[:, -1:] >= self.levels, 1.0, reached)
        floor = 0.2  # a0: share that does not depend on learning
        return np.asarray(floor + (1.0 - floor) * (reached / self.chances).mean(axis=1))


def learn(stages: Sequence[Paths], seed: tuple[int, ...]) -> Potentials | None:
    """Return potentials learnt from the stages so far; None where no level has rollouts enough.

    Args:
        stages: Rollouts of each.
        seed: Seed of the training.
    """
    paths = Paths.join(stages)
    if not paths.weights.any():  # every rollout broke down
        return None
    levels, chances = _choose_levels(paths)
    if not len(levels):
        return None
    reached = np.where(np.isinf(levels), paths.violated[:, None], _depth(paths)[:, None] >= levels)
    # a fifth of the first ancestors is held out of training
    examples = Examples(paths.features, reached, paths.weights, paths.root % 5 == 0)
    if not all(reached[part].any(axis=0).all() for part in (examples.held_out, ~examples.held_out)):
        return None
    network = fit(examples, seed)
    steps = examples.features.shape[1]
    potentials = Potentials(network, np.zeros(steps), levels, chances)
    gains = np.array([_gain(potentials, examples, k) for k in range(steps)])
    return replace(potentials, gains=np.round(gains, 4))


def _depth(paths: Paths) -> Floats:
    return np.where(paths.violated, np.inf, paths.score)


def _choose_levels(paths: Paths) -> tuple[Floats, Floats]:
    """Return levels a factor of about 3 apart, down to failure or to the deepest that is known."""
    depth, weights = _depth(paths), paths.weights / paths.weights.sum()
    order = np.argsort(-depth, kind="stable")
    beyond = np.cumsum(weights[order])
    levels: dict[float, float] = {}
    for chance in 10.0 ** (-np.arange(1, 25) / 2.0):
        level = float(depth[order[min(int(np.searchsorted(beyond, chance)), len(order) - 1)]])
        hit = depth >= level
        if effective_size(weights[hit]) < _LEAST_HITS or np.isinf(level):
            break
        levels[level] = float(weights[hit].sum())
    if effective_size(weights[paths.violated]) >= _LEAST_HITS:
        levels[np.inf] = float(weights[paths.violated].sum())
    chosen = list(levels.items())
    most_levels = 6
    if len(chosen) > most_levels:
        places = np.unique(np.linspace(0, len(chosen) - 1, most_levels).round().astype(int))
        chosen = [chosen[k] for k in places]
    return np.array([level for level, _ in chosen]), np.array([chance for _, chance in chosen])


def _gain(potentials: Potentials, examples: Examples, step: int) -> float:
    """Return the mean of log h / E h over rollouts that reach the deepest level, less its standard error.

    The rollouts were held out, so that a potential that is confident and wrong has a negative mean.
    """
    rows = examples.held_out & ~np.isnan(examples.features[:, step, -1])
    weights, hit = examples.weights[rows], examples.reached[rows, -1]
    if effective_size(weights[hit]) < 2.0:
        return 0.0
    h = potentials(step, examples.features[rows, step].astype(np.float64))
    nats = np.log(h / np.average(h, weights=weights))[hit]
    mean = float(np.average(nats, weights=weights[hit]))
    spread = float(np.average((nats - mean) ** 2, weights=weights[hit]))
    return mean - float(np.sqrt(spread / effective_size(weights[hit])))
