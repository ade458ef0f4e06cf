"""Dictionary of atoms, and the weights of those that explain an elite: expectation-maximisation.

Given failures (or rows near them) with importance weights, the shares of the mixture
a0 p + sum_j a_j g_j maximise the weighted likelihood, which is concave in the shares: the cross-entropy
method for a mixture whose components are given. The iteration stops early. An elite of eighty rows cannot
tell thousands of shares; converged, it would put all weight on the few atoms nearest to its own rows.
"""

from __future__ import annotations

import math
import numpy as np

from avrare.protocols import Floats
from avrare.rollout.request import Integers
from avrare_estimators.importance.tape_mixture import NO_ATOM, Atoms, Row, TapeMixture

WIDE = 2.5
"""Standard deviation of a widened coordinate: failures at 3 to 5 standard deviations become frequent."""
_AMOUNTS = (2.0, 3.2, 4.5)
"""Lengths of the mean of a shifted window, as a vector: 4.5 shifts its sum by 4.5 of its own deviations."""
_DECAYS = (0.5, 0.75, 0.9)
_SHORTEST = 4
_OVERLAP = 4
"""Windows of w steps begin every w / 4 steps."""
_ROUNDS = 30
_MOST_ATOMS, _MOST_PAIRED = 4000, 24
_LEAST_SHARE = 1e-4
_LEAK = 0.2
"""Share of an atom that each of its neighbours in time gets: an elite does not know the step exactly."""


def atoms_of_channel(channel: int, steps: int) -> Atoms:
    """Return all atoms of one channel of a tape with ``steps`` steps after the start."""
    rows: list[Row] = [(channel, t, t, 0.0, 1.0, WIDE) for t in range(steps + 1)]
    windows = [(0, 0, 1.0)]
    width = _SHORTEST
    while width < 2 * steps:
        w = min(width, steps)
        windows += [(t, t + w - 1, 1.0) for t in range(1, steps + 2 - w, max(1, w // _OVERLAP))]
        width *= 2
    for decay in _DECAYS:
        stride = max(1, round(1.0 / (1.0 - decay) / _OVERLAP))
        windows += [(1, t, decay) for t in range(2, steps + 1, stride)]
    for first, last, decay in windows:
        length = math.sqrt(sum(decay ** (2 * k) for k in range(last - first + 1)))
        rows += [(channel, first, last, sign * a / length, decay, 1.0) for a in _AMOUNTS for sign in (1, -1)]
    return Atoms.of(rows)


def fit(tapes: Floats, weights: Floats, defensive: float) -> TapeMixture:
    """Return the mixture under which weighted tapes are likely.

    Args:
        tapes: (E, steps + 1, noise_size).
        weights: (E,) positive.
        defensive: Share of the target beside the mixture.
    """
    weights = weights / weights.sum()
    # 1. Atoms that promise most, each for itself.
    atoms = _screened(tapes, weights)
    logs = log_ratios(atoms, tapes)
    parts = np.stack([np.arange(atoms.size), np.full(atoms.size, NO_ATOM)], axis=1)
    share = _shares(logs, weights, defensive)
    # 2. Pairs of the strongest ones: failures may need two outliers at once.
    best = np.argsort(-share, kind="stable")[:_MOST_PAIRED]
    rows = atoms.rows
    pairs = [(i, j) for n, i in enumerate(best) for j in best[:n] if not _overlap(rows[i], rows[j])]
    strong = np.flatnonzero(share > _LEAST_SHARE)
    parts = np.concatenate([parts[strong], np.array(pairs, dtype=np.int64).reshape(-1, 2)])
    padded = np.concatenate([logs, np.zeros((len(logs), 1))], axis=1)
    share = _shares(padded[:, parts[:, 0]] + padded[:, parts[:, 1]], weights, defensive)
    kept = share > _LEAST_SHARE * share.sum()
    # 3. What happened at one step may as well happen at the next.
    shape = (tapes.shape[1], tapes.shape[2])
    return _smoothed(atoms, parts[kept], share[kept], shape)


def log_ratios(atoms: Atoms, tapes: Floats) -> Floats:
    """Return log g/p (E, A) of complete tapes under each atom; for learning, not for weights."""
    found = np.empty((len(tapes), atoms.size))
    steps = np.arange(tapes.shape[1])
    for channel in np.unique(atoms.channel):
        own = np.flatnonzero(atoms.channel == channel)
        part = atoms.take(own)
        inside = (steps >= part.first[:, None]) & (steps <= part.last[:, None])
        ages = np.maximum(part.last[:, None] - steps, 0)
        mean = np.where(inside, part.shift[:, None] * part.decay[:, None] ** ages, 0.0)
        precision = part.scale**-2
        x = tapes[:, :, channel]
        values = x @ (mean * precision[:, None]).T
        wide = part.scale != 1.0
        values[:, wide] += (x * x) @ (0.5 * (1.0 - precision[wide, None]) * inside[wide]).T
        constant = 0.5 * (mean**2).sum(axis=1) * precision + np.log(part.scale) * inside.sum(axis=1)
        found[:, own] = values - constant
    return found


def _screened(tapes: Floats, weights: Floats) -> Atoms:
    steps, channels = tapes.shape[1] - 1, tapes.shape[2]
    rows: list[Row] = []
    gains = []
    for channel in range(channels):
        atoms = atoms_of_channel(channel, steps)
        ratio = np.exp(np.minimum(log_ratios(atoms, tapes), 50.0))
        # The slope of the likelihood where half of the weight is the target's: bounded for any single row.
        slope = weights @ (ratio / (0.5 + 0.5 * ratio))
        best = np.argsort(-slope, kind="stable")[:_MOST_ATOMS]
        rows += atoms.take(best).rows
        gains.append(slope[best])
    order = np.argsort(-np.concatenate(gains), kind="stable")[:_MOST_ATOMS]
    return Atoms.of([rows[i] for i in np.sort(order)])


def _shares(logs: Floats, weights: Floats, defensive: float) -> Floats:
    """Return shares (J,) after some rounds of expectation-maximisation from equal ones."""
    ratio = np.exp(np.minimum(logs, 50.0))
    share = np.full(logs.shape[1], (1.0 - defensive) / logs.shape[1])
    alive = np.arange(logs.shape[1])
    for turn in range(_ROUNDS):
        share[alive] *= (weights / (defensive + ratio @ share[alive])) @ ratio
        share *= (1.0 - defensive) / share.sum()
        if turn % 10 == 9:
            kept = share[alive] > 1e-6 * share.max()
            share[np.setdiff1d(np.arange(len(share)), alive[kept])] = 0.0
            alive, ratio = alive[kept], ratio[:, kept]
    return share


def _overlap(one: Row, other: Row) -> bool:
    return one[0] == other[0] and one[1] <= other[2] and other[1] <= one[2]


def _smoothed(atoms: Atoms, parts: Integers, share: Floats, shape: tuple[int, int]) -> TapeMixture:
    """Return the mixture with part of each component's share given to its neighbours in time."""
    rows, place, total = atoms.rows, dict[Row, int](), dict[tuple[int, int], float]()
    for pair, amount in zip(parts.tolist(), share.tolist(), strict=True):
        for delay, part in ((-1, _LEAK), (0, 1.0 - 2.0 * _LEAK), (1, _LEAK)):
            own = [rows[a] for a in pair if a != NO_ATOM]
            moved = [_moved(row, delay, shape[0]) for row in own]
            if len(moved) == 2 and _overlap(*moved):
                moved = own
            index = [place.setdefault(row, len(place)) for row in moved] + [NO_ATOM]
            key = (index[0], index[1])
            total[key] = total.get(key, 0.0) + part * amount
    return TapeMixture.frozen(
        Atoms.of(list(place)), np.array(list(total), dtype=np.int64), np.array(list(total.values())), shape
    )


def _moved(row: Row, delay: int, length: int) -> Row:
    """Return an atom one stride of its own later or earlier, as far as the tape goes."""
    channel, first, last, shift, decay, scale = row
    if scale != 1.0:
        stride = 1.0
    elif decay < 1.0:
        stride = max(1, round(1.0 / (1.0 - decay) / _OVERLAP))
    else:
        stride = max(1, (last - first + 1) // _OVERLAP)
    least = first if decay < 1.0 else 1.0
    t0, t1 = first + delay * stride * (decay == 1.0), last + delay * stride
    return (channel, t0, t1, shift, decay, scale) if least <= t0 <= t1 < length else row
