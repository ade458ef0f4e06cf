"""Dictionary of small changes of a tape, and the shares of those that explain an elite.

Given failures (or rows near them) with importance weights, the shares of the mixture
a0 p + sum_j a_j g_j maximise the weighted likelihood, which is concave in the shares: the cross-entropy
method for a mixture whose components are given, by expectation-maximisation. The dictionary has several
resolutions in time, as eighty rows tell soon that a channel matters, and later at which step: single atoms,
and groups that draw one atom of many. The iteration stops early. Converged, it would put all weight on the
few atoms nearest to the elite's own rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from avrare.protocols import Floats
from avrare_estimators.importance.tape_mixture import Atoms, Group, Row, TapeMixture

WIDE = 2.5
"""Standard deviation of a widened coordinate: failures at 3 to 5 standard deviations become frequent."""
_AMOUNTS = (2.0, 3.2, 4.5)
"""Lengths of the mean of a shifted window, as a vector: 4.5 shifts its sum by 4.5 of its own deviations."""
_DECAYS = (0.5, 0.75, 0.9)
_SHORTEST = 4
_OVERLAP = 4
"""Windows of w steps begin every w / 4 steps."""
_ROUNDS = 30
_MOST_ITEMS, _MOST_GROUPS = 4000, 12
_LEAST_SHARE = 1e-3
_LEAST_SCORE = 2.5
"""Standard deviations above chance from which an entry is tried: of a thousand, six are by chance."""
_LEAK = 0.2
"""Share of an atom that each of its neighbours in time gets: an elite does not know the step exactly."""
_CHANCE_ROWS = 4000
_LARGEST_LOG = 50.0


@dataclass(frozen=True)
class ChannelEntries:
    """Entries of the dictionary for one channel, of A atoms and X groups of them.

    Attributes:
        atoms: Atoms, of channel 0.
        groups: (A, X) shares of the atoms in each group.
        mean: (A + X,) mean of each entry's posterior on target rows.
        deviation: (A + X,) its standard deviation there.
        kind: (A + X,) number of the entry's kind: widening or shift, single or group.
    """

    atoms: Atoms
    groups: Floats
    mean: Floats
    deviation: Floats
    kind: Floats

    def ratios(self, tapes: Floats, channel: int) -> Floats:
        """Return g/p (E, A + X) of tapes (E, steps + 1, noise_size)."""
        logs = log_ratios(replace(self.atoms, channel=np.full(self.atoms.size, channel)), tapes)
        single = np.exp(np.minimum(logs, _LARGEST_LOG))
        return np.concatenate([single, single @ self.groups], axis=1)

    def entry(self, index: int, channel: int) -> Group:
        """Return the atoms of an entry and their shares."""
        if index < self.atoms.size:
            return {(channel, *self.atoms.rows[index][1:]): 1.0}
        shares = self.groups[:, index - self.atoms.size]
        rows = self.atoms.rows
        return {(channel, *rows[a][1:]): float(shares[a]) for a in np.flatnonzero(shares)}


@cache
def entries_of_channel(steps: int) -> ChannelEntries:
    """Return the dictionary of a channel of a tape with ``steps`` steps after the start."""
    rows, families = _atoms(steps)
    atoms = Atoms.of(rows)
    groups = np.zeros((len(rows), len(families)))
    for x, family in enumerate(families):
        groups[family, x] = 1.0 / len(family)
    single = (atoms.scale == 1.0) * 1.0
    several = np.array([single[family[0]] + 2.0 for family in families])
    kind = np.concatenate([single, several])
    found = ChannelEntries(atoms, groups, kind, kind, kind)
    # What an entry's posterior is by chance: the same tapes in every process and for every problem.
    tapes = np.random.default_rng(0).standard_normal((_CHANCE_ROWS, steps + 1, 1))
    posterior = _posterior(found.ratios(tapes, 0))
    return replace(found, mean=posterior.mean(axis=0), deviation=posterior.std(axis=0) + 1e-12)


def dictionary_bytes(steps: int) -> int:
    """Return the bytes that the dictionary of a channel takes to be made."""
    rows, families = _atoms(steps)
    return 8 * (3 * _CHANCE_ROWS + len(rows)) * (len(rows) + len(families))


def _atoms(steps: int) -> tuple[list[Row], list[list[int]]]:
    """Return the atoms of channel 0, and the groups of them that differ only in time."""
    rows: list[Row] = [(0, t, t, 0.0, 1.0, WIDE) for t in range(steps + 1)]
    families: list[list[int]] = []
    width = _SHORTEST
    while width < 2 * steps:
        w = min(width, steps)
        begins = range(1, steps + 2 - w, max(1, w // 2))
        families += [list(range(t, t + w)) for t in begins]
        width *= 2
    for windows in _windows(steps):
        for amount in _AMOUNTS:
            for sign in (1.0, -1.0):
                family = range(len(rows), len(rows) + len(windows))
                rows += [(0, t0, t1, sign * amount / length, d, 1.0) for t0, t1, d, length in windows]
                families += [list(family)] if len(family) > 1 else []
    return rows, families


def _windows(steps: int) -> list[list[tuple[int, int, float, float]]]:
    """Return windows (first, last, decay, length of the unscaled mean), those of one shape together."""
    shapes = [[(0, 0, 1.0)]]
    width = _SHORTEST
    while width < 2 * steps:
        w = min(width, steps)
        shapes.append([(t, t + w - 1, 1.0) for t in range(1, steps + 2 - w, _stride(w, 1.0))])
        width *= 2
    shapes += [[(1, t, d) for t in range(2, steps + 1, _stride(1, d))] for d in _DECAYS if steps > 1]
    return [
        [(a, b, d, math.sqrt(sum(d ** (2 * k) for k in range(b - a + 1)))) for a, b, d in windows]
        for windows in shapes
    ]


def _stride(width: float, decay: float) -> int:
    """Return the steps from one window of a shape to the next."""
    return max(1, round((1.0 / (1.0 - decay) if decay < 1.0 else width) / _OVERLAP))


def fit(tapes: Floats, weights: Floats, defensive: float) -> TapeMixture:
    """Return the mixture under which weighted tapes are likely.

    Args:
        tapes: (E, steps + 1, noise_size).
        weights: (E,) positive.
        defensive: Share of the target beside the mixture.
    """
    weights = weights / weights.sum()
    shape = (tapes.shape[1], tapes.shape[2])
    # 1. Entries that the tapes speak for, and their shares.
    entries, ratios, kind = _screened(tapes, weights)
    share = _shares(ratios, weights, defensive, _even(kind))
    single: dict[tuple[tuple[Row, float], ...], float] = {}
    for k in np.flatnonzero(share > _LEAST_SHARE * share.max()):
        for group, amount in _smoothed(entries[k], float(share[k]), shape[0]):
            key = tuple(group.items())
            single[key] = single.get(key, 0.0) + amount
    components: list[tuple[float, list[Group]]] = [(a, [dict(key)]) for key, a in single.items()]
    # 2. Failures may need two outliers at once: pairs of channels, each with its entries' proportions.
    groups = _strongest(components)
    pairs = [[i, j] for n, i in enumerate(groups) for j in groups[:n] if _channel(i) != _channel(j)]
    if pairs:
        start = np.array([amount for amount, _ in components] + [sum(share) / len(pairs)] * len(pairs))
        candidates = [own for _, own in components] + pairs
        ratios = np.exp(np.minimum(_component_logs(candidates, tapes), _LARGEST_LOG))
        share = _shares(ratios, weights, defensive, start)
        components = [(float(a), own) for a, own in zip(share, candidates, strict=True)]
    return TapeMixture.frozen(components, shape)


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


def _screened(tapes: Floats, weights: Floats) -> tuple[list[Group], Floats, Floats]:
    """Return the entries that the tapes speak for, their g/p (E, J), and their kinds (J,).

    Each entry is judged by its posterior where it had half of the weight, r / (1 + r) with r = g / p, which
    no single row can dominate, against that of target rows.
    """
    table = entries_of_channel(tapes.shape[1] - 1)
    noise_of_mean = math.sqrt(float((weights**2).sum()))
    found: list[tuple[float, int, int]] = []
    columns: list[Floats] = []
    for channel in range(tapes.shape[2]):
        ratios = table.ratios(tapes, channel)
        score = (weights @ _posterior(ratios) - table.mean) / (table.deviation * noise_of_mean)
        best = np.argsort(-score, kind="stable")[:_MOST_ITEMS]
        best = best[(score[best] > _LEAST_SCORE) | (best == best[0])]  # the best of each channel is tried
        found += [(-float(score[k]), channel, int(k)) for k in best]
        columns.append(ratios[:, best])
    order = sorted(range(len(found)), key=found.__getitem__)[:_MOST_ITEMS]
    entries = [table.entry(found[i][2], found[i][1]) for i in order]
    return entries, np.concatenate(columns, axis=1)[:, order], table.kind[[found[i][2] for i in order]]


def _posterior(ratios: Floats) -> Floats:
    return np.asarray(ratios / (1.0 + ratios))


def _even(kind: Floats) -> Floats:
    """Return first shares with which all kinds of entries have the same total."""
    _, index, counts = np.unique(kind, return_inverse=True, return_counts=True)
    return np.asarray(1.0 / counts[index])


def _shares(ratios: Floats, weights: Floats, defensive: float, start: Floats) -> Floats:
    """Return shares (J,) after some rounds of expectation-maximisation from the first ones."""
    share: Floats = (1.0 - defensive) * start / start.sum()
    alive = np.arange(len(share))
    for turn in range(_ROUNDS):
        share[alive] *= (weights / (defensive + ratios @ share[alive])) @ ratios
        share *= (1.0 - defensive) / max(float(share.sum()), 1e-300)
        if turn % 10 == 9:
            kept = share[alive] > 1e-6 * share.max()
            share[np.setdiff1d(np.arange(len(share)), alive[kept])] = 0.0
            alive, ratios = alive[kept], ratios[:, kept]
    return share


def _smoothed(group: Group, share: float, length: int) -> list[tuple[Group, float]]:
    """Return a single atom and its neighbours in time, each with a part of the share; a group as it is."""
    if len(group) > 1:
        return [(group, share)]
    row = next(iter(group))
    parts = ((-1, _LEAK), (0, 1.0 - 2.0 * _LEAK), (1, _LEAK))
    return [({_moved(row, delay, length): 1.0}, part * share) for delay, part in parts]


def _moved(row: Row, delay: int, length: int) -> Row:
    """Return an atom one stride of its own later or earlier, as far as the tape goes."""
    channel, first, last, shift, decay, scale = row
    by = delay * (1 if scale != 1.0 else _stride(last - first + 1, decay))
    begin, end = (first if decay < 1.0 else first + by), last + by
    return (channel, begin, end, shift, decay, scale) if 1 <= begin <= end < length else row


def _strongest(components: Sequence[tuple[float, list[Group]]]) -> list[Group]:
    """Return what widens a channel, what raises it and what lowers it, as groups; the strongest ones."""
    found: dict[Any, Group] = {}
    for amount, (group,) in components:
        for row, part in group.items():
            own = found.setdefault((row[0], float(np.sign(row[3]))), {})
            own[row] = own.get(row, 0.0) + amount * part
    return sorted(found.values(), key=lambda group: -sum(group.values()))[:_MOST_GROUPS]


def _channel(group: Group) -> int:
    return int(next(iter(group))[0])


def _component_logs(components: Sequence[list[Group]], tapes: Floats) -> Floats:
    mixture = TapeMixture.frozen([(1.0, groups) for groups in components], (tapes.shape[1], tapes.shape[2]))
    logs = mixture.component_logs(log_ratios(mixture.atoms, tapes))
    return np.asarray(logs + math.log(len(components)))
