"""Gain that a learned score promises over the problem's own, from rollouts that it was not learnt from.

With q the committor where rollouts come to a level of a score first, the relative variance of a run of N
particles is about

    (1/N) int (1 + 2 c) d(-log r),        c = E q^2 / (E q)^2 - 1 at the entrance,

over the shares r of its levels from 1 to p (Cerou, Delyon, Guyader and Rousset 2019), and each level costs
the steps that are left there. That score is best whose levels are met by rollouts that are all equally likely
to fail. q is not known, but the learnt q' is, and which rollouts failed: by Cauchy and Schwarz E q^2 is at
least (E q q')^2 / E q'^2, where E q q' = E 1_F q'. Of rollouts held out a network that knows its own by heart
explains nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.protocols import Bools, Floats
from avrare_estimators.common.committor.network import sigmoid
from avrare_estimators.common.committor.potentials import HELD_OUT, Paths, Potentials

_GROUPS = 10
"""Groups of first ancestors that are left out in turn."""
_STEP = 0.25
"""Distance of the levels in the log of their share."""


@dataclass(frozen=True)
class Promise:
    """Variance times cost by the problem's score over that by the learned one, with a standard error."""

    gain: float
    error: float

    @property
    def sure(self) -> float:
        """Gain less its standard error."""
        return self.gain - self.error


@dataclass(frozen=True)
class _Ways:
    """Rollouts that were held out.

    Attributes:
        score: (n, K) running score at scheduled steps.
        final: (n,) final score, infinite for failures.
        committor: (n, K) learnt probability of a failure.
        left: (K + 1,) share of the steps that are left after each scheduled step, 0 at the end.
        weights: (n,) they sum to 1.
        violated: (n,) the rollout fails.
    """

    score: Floats
    final: Floats
    committor: Floats
    left: Floats
    weights: Floats
    violated: Bools


def promise_gain(potentials: Potentials, paths: Paths, steps: int) -> Promise:
    """Return the gain on rollouts held out, with an error by leaving out groups of ancestors in turn."""
    held = paths.root % HELD_OUT == 0
    features, violated = paths.features[held].astype(np.float64), paths.violated[held]
    times = np.tile(np.arange(features.shape[1]), len(features))
    odds = potentials.log_odds(times, features.reshape(len(times), -1)).reshape(features.shape[:2])
    learned = np.maximum.accumulate(odds, axis=1)
    common: dict[str, Any] = {
        "committor": sigmoid(odds),
        "left": np.append(1.0 - potentials.schedule / steps, 0.0),
        "violated": violated,
    }
    scores = [
        (features[:, :, -1], np.where(violated, np.inf, paths.score[held])),
        (learned, np.where(violated, np.inf, learned[:, -1])),
    ]

    def log_gain(rows: Bools) -> float:
        weights = np.where(rows, paths.weights[held], 0.0)
        costs = [_cost(_Ways(*score, weights=weights / weights.sum(), **common)) for score in scores]
        return float(np.log(costs[0] / costs[1]))

    group, error = paths.root[held] // HELD_OUT % _GROUPS, np.inf
    others = [group != k for k in range(_GROUPS)]
    if all(violated[rows].any() for rows in others):  # else one group has all that is known
        error = float(np.sqrt((_GROUPS - 1) * np.var([log_gain(rows) for rows in others])))
    gain = float(np.exp(log_gain(np.ones(len(group), dtype=bool))))
    return Promise(gain, gain * error)


def _cost(ways: _Ways) -> float:
    """Return the relative variance of a particle of a run, times its steps in full rollouts."""
    order = np.argsort(-ways.final, kind="stable")
    beyond = np.cumsum(ways.weights[order])
    probability = float(ways.weights[ways.violated].sum())
    shares = np.exp(-np.arange(_STEP, -np.log(probability), _STEP))
    levels = np.unique(ways.final[order[np.minimum(np.searchsorted(beyond, shares), len(order) - 1)]])
    variance, steps, before = 0.0, 1.0, 1.0
    for level in levels[np.isfinite(levels)]:
        share, spread, left = _entrance(ways, level)
        # Of scores that many rollouts share a level is met all at once, as in Monte Carlo.
        variance += before / share - 1.0 + 2.0 * spread * np.log(before / share)
        steps += left * np.log(before / share)
        before = share
    return (variance + before / probability - 1.0) * steps


def _entrance(ways: _Ways, level: float) -> tuple[float, float, float]:
    """Return the share that comes to a level, c there, and the mean share of the steps that are left."""
    rows = np.flatnonzero(ways.violated | (ways.final > level))
    above = ways.score[rows] > level
    step = np.where(above.any(axis=1), above.argmax(axis=1), above.shape[1])
    weights, failed = ways.weights[rows], ways.violated[rows]
    committors = np.append(ways.committor[rows], failed[:, None], axis=1)  # at the end it is known
    committor = committors[np.arange(len(rows)), step]
    hit, joint = float(weights @ failed), float((weights * failed) @ committor)
    square = float(weights @ committor**2)
    share = float(weights.sum())
    spread = joint**2 * share / (square * hit**2) if square > 0.0 else 1.0
    return share, max(spread - 1.0, 0.0), float(weights @ ways.left[step] / share)
