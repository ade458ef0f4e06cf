"""Dictionary of small changes of a tape, and the shares of those that explain an elite.

Given failures (or rows near them) with importance weights, the shares of the mixture q = a0 p + sum_j a_j g_j
go towards the least mean of p/q, which is the relative variance of importance sampling and convex in the
shares. (Likelihood, the aim of the cross-entropy method, gives up on the few rows that are hardest to
explain, and these make most of the variance.) The dictionary has several
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
from avrare_estimators.common.tapes.atoms import Atoms, Group, Row, log_ratios
from avrare_estimators.common.tapes.tape_mixture import TapeMixture

_LAWS = ((0.0, 2.5), (2.0, 1.0), (-2.0, 1.0), (3.2, 1.0), (-3.2, 1.0), (4.5, 1.0), (-4.5, 1.0))
"""Mean and standard deviation along a direction: widened, which reaches both tails, or shifted."""
_SHAPES = ((0.5, 0.0), (0.8, 0.0), (0.8, 0.35), (0.9, 0.0), (0.9, 0.35))
"""Decay per step and share of step 0 of directions that fade."""
_FADED = 0.02
_SHORTEST = 4
_OVERLAP = 4
"""Windows of w steps begin every w / 4 steps."""
_LEAST_NATS = 0.3
"""Gain in held-out likelihood from which pairs of channels are drawn."""
_MOST_ITEMS, _MOST_GROUPS = 4000, 12
_LEAST_SHARE = 1e-3
_LEAST_SCORE = 2.5
"""Standard deviations above chance from which an entry is tried: of a thousand, six are by chance."""
_LEAK = 0.2
"""Share of an atom that each of its neighbours in time gets: an elite does not know the step exactly."""
_MIRRORED = 0.25
"""Share of a shift that the shift the other way gets: a mode that a small elite lacks must not be lost."""
_FOLDS = 3
_CHANCE_ROWS, _CHANCE_BLOCK = 4000, 500
_LARGEST_LOG = 50.0


@dataclass(frozen=True)
class ChannelEntries:
    """Entries of the dictionary for one channel: under each of L laws D directions and X groups of them.

    Attributes:
        shapes: Atoms of channel 0, one for each direction, under the first law.
        vectors: (D, steps + 1) directions.
        groups: (D, X) shares of the directions in each group.
        mean: (L (D + X),) mean of each entry's posterior on target rows.
        deviation: (L (D + X),) its standard deviation there.
        kind: (L (D + X),) number of the entry's kind: widening or shift, single or group.
    """

    shapes: Atoms
    vectors: Floats
    groups: Floats
    mean: Floats
    deviation: Floats
    kind: Floats

    def ratios(self, tapes: Floats, channel: int) -> Floats:
        """Return g/p (E, L (D + X)) of tapes (E, steps + 1, noise_size)."""
        along = tapes[:, :, channel] @ self.vectors.T
        parts = []
        for law in range(len(_LAWS)):
            logs = self._under(law).logs(along, np.ones(1))
            single = np.exp(np.minimum(logs, _LARGEST_LOG))
            parts += [single, single @ self.groups]
        return np.concatenate(parts, axis=1)

    def _under(self, law: int) -> Atoms:
        shift, scale = (np.full(self.shapes.size, value) for value in _LAWS[law])
        return replace(self.shapes, shift=shift, scale=scale)

    def entry(self, index: int, channel: int) -> Group:
        """Return the atoms of an entry and their shares."""
        directions, groups = self.groups.shape
        law, place = divmod(index, directions + groups)
        if place < directions:
            inside, part = np.array([place]), 1.0
        else:
            inside = np.flatnonzero(self.groups[:, place - directions])
            part = 1.0 / len(inside)
        rows = self.shapes.rows
        return {(channel, *rows[d][1:5], *_LAWS[law]): part for d in inside}


@cache
def entries_of_channel(steps: int) -> ChannelEntries:
    """Return the dictionary of a channel of a tape with ``steps`` steps after the start."""
    shapes, families = _directions(steps)
    atoms = Atoms.of([(*row, *_LAWS[0]) for row in shapes])
    # Directions in the order of ``shapes``: they are distinct.
    vectors = np.empty((len(shapes), steps + 1))
    vectors[atoms.directions[0]] = atoms.vectors(steps)
    groups = np.zeros((len(shapes), len(families)))
    for x, family in enumerate(families):
        groups[family, x] = 1.0 / len(family)
    kind = np.concatenate(
        [np.repeat([2.0 * (scale == 1.0), 2.0 * (scale == 1.0) + 1.0], groups.shape) for _, scale in _LAWS]
    )
    entries = ChannelEntries(atoms, vectors, groups, kind, kind, kind)
    # What an entry's posterior is by chance: the same tapes in every process and for every problem.
    rng, count = np.random.default_rng(0), 0
    total, squares = np.zeros(len(kind)), np.zeros(len(kind))
    while count < _CHANCE_ROWS:
        posterior = _posterior(entries.ratios(rng.standard_normal((_CHANCE_BLOCK, steps + 1, 1)), 0))
        total, squares, count = (
            total + posterior.sum(axis=0),
            squares + (posterior**2).sum(axis=0),
            count + _CHANCE_BLOCK,
        )
    mean = total / count
    return replace(entries, mean=mean, deviation=np.sqrt(np.maximum(squares / count - mean**2, 0.0)) + 1e-12)


def dictionary_bytes(steps: int) -> int:
    """Return the bytes that the dictionary of a channel takes to be made."""
    shapes, families = _directions(steps)
    entries = len(_LAWS) * (len(shapes) + len(families))
    return 8 * (3 * _CHANCE_BLOCK * entries + len(shapes) * len(families))


def _directions(steps: int) -> tuple[list[Row], list[list[int]]]:
    """Return directions (channel 0, first, last, decay, start), and groups that differ only in time."""
    directions: list[Row] = []
    families: list[list[int]] = []
    for shape in _shapes(steps):
        places = list(range(len(directions), len(directions) + len(shape)))
        directions += shape
        first = 1 if shape[0][1] == 0 else 0  # step 0 has its own law in many systems
        width = _SHORTEST if shape[0][1] == shape[0][2] else 2 * _SHORTEST
        while len(places) > 1 and width < 2 * len(places):
            w = min(width, len(places) - first)
            families += [places[k : k + w] for k in range(first, len(places) + 1 - w, max(1, w // 2))]
            width *= 2
    return directions, families


def _shapes(steps: int) -> list[list[Row]]:
    """Return the directions of each shape, in the order of time."""
    shapes: list[list[Row]] = [[(0, t, t, 1.0, 0.0) for t in range(steps + 1)]]
    width = _SHORTEST
    while width < 2 * steps:
        w = min(width, steps)
        shapes.append([(0, t, t + w - 1, 1.0, 0.0) for t in range(1, steps + 2 - w, _stride(w, 1.0))])
        width *= 2
    for decay, start in _SHAPES if steps > 1 else ():
        reach = math.ceil(math.log(_FADED) / math.log(decay))
        lasts = range(2, steps + 1, _stride(1, decay))
        shapes.append([(0, max(1, t - reach), t, decay, start) for t in lasts])
    return shapes


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
    table, places, ratios = _screen_entries(tapes, weights)
    kind = table.kind[[index for _, index in places]]
    start = _even(kind)
    rounds = _best_rounds(ratios, weights, defensive, start)
    share = _shares(ratios, weights, defensive, start, rounds)
    single: dict[tuple[tuple[Row, float], ...], float] = {}
    for k in np.flatnonzero(share > _LEAST_SHARE * share.max()):
        channel, index = places[k]
        for group, amount in _smooth_entry(table.entry(index, channel), float(share[k]), shape[0]):
            key = tuple(group.items())
            single[key] = single.get(key, 0.0) + amount
    components: list[tuple[float, list[Group]]] = [(a, [dict(key)]) for key, a in single.items()]
    # 2. Failures may need two outliers at once: pairs of channels, each with its entries' proportions.
    groups = _strongest(components)
    pairs = [[i, j] for n, i in enumerate(groups) for j in groups[:n] if _channel(i) != _channel(j)]
    if pairs:
        start = np.array([amount for amount, _ in components] + [sum(share) / len(pairs)] * len(pairs))
        candidates = [parts for _, parts in components] + pairs
        ratios = _component_ratios(candidates, tapes)
        if _held_out_gain(ratios, weights, defensive, start, len(components), rounds) > _LEAST_NATS:
            share = _shares(ratios, weights, defensive, start, rounds)
            components = [(float(a), parts) for a, parts in zip(share, candidates, strict=True)]
    return TapeMixture.freeze(components, shape)


def _screen_entries(tapes: Floats, weights: Floats) -> tuple[ChannelEntries, list[tuple[int, int]], Floats]:
    """Return the dictionary, channel and index of its entries that the tapes speak for, their g/p (E, J).

    Each entry is judged by its posterior where it had half of the weight, r / (1 + r) with r = g / p, which
    no single row can dominate, against that of target rows.
    """
    table = entries_of_channel(tapes.shape[1] - 1)
    noise_of_mean = math.sqrt(float((weights**2).sum()))
    entries: list[tuple[float, int, int]] = []
    columns: list[Floats] = []
    for channel in range(tapes.shape[2]):
        ratios = table.ratios(tapes, channel)
        score = (weights @ _posterior(ratios) - table.mean) / (table.deviation * noise_of_mean)
        best = np.argsort(-score, kind="stable")[:_MOST_ITEMS]
        best = best[(score[best] > _LEAST_SCORE) | (best == best[0])]  # the best of each channel is tried
        entries += [(-float(score[k]), channel, int(k)) for k in best]
        columns.append(ratios[:, best])
    order = sorted(range(len(entries)), key=entries.__getitem__)[:_MOST_ITEMS]
    places = [entries[i][1:] for i in order]
    return table, places, np.concatenate(columns, axis=1)[:, order]


def _posterior(ratios: Floats) -> Floats:
    return np.asarray(ratios / (1.0 + ratios))


def _even(kind: Floats) -> Floats:
    """Return first shares with which all kinds of entries have the same total."""
    _, index, counts = np.unique(kind, return_inverse=True, return_counts=True)
    return np.asarray(1.0 / counts[index])


def _shares(ratios: Floats, weights: Floats, defensive: float, start: Floats, rounds: int) -> Floats:
    """Return shares (J,) after some rounds from the first ones towards the least second moment."""
    share: Floats = (1.0 - defensive) * start / start.sum()
    for _ in range(rounds):
        share = _improve_shares(share, ratios, weights, defensive)
    return share


def _improve_shares(share: Floats, ratios: Floats, weights: Floats, defensive: float) -> Floats:
    """Return shares after a round.

    It is one of expectation-maximisation with each row weighed by p/q as well. Its fixed point is the minimum
    of sum_i w_i / (a0 + sum_j a_j r_ij), which is convex: rows that nothing covers yet count most.
    """
    share = share * ((weights / (defensive + ratios @ share) ** 2) @ ratios)
    return np.asarray(share * (1.0 - defensive) / max(float(share.sum()), 1e-300))


def _best_rounds(ratios: Floats, weights: Floats, defensive: float, start: Floats) -> int:
    """Return the number of rounds after which rows left out have the least second moment."""
    most_rounds = 20
    loss = np.zeros(most_rounds)
    for fold in range(_FOLDS):
        out = np.arange(len(weights)) % _FOLDS == fold
        fitted, held_out = ratios[~out], ratios[out]
        share = (1.0 - defensive) * start / start.sum()
        for turn in range(most_rounds):
            share = _improve_shares(share, fitted, weights[~out], defensive)
            loss[turn] += weights[out] @ (1.0 / (defensive + held_out @ share))
    return int(loss.argmin()) + 1


def _held_out_gain(
    ratios: Floats, weights: Floats, defensive: float, start: Floats, count: int, rounds: int
) -> float:
    """Return the gain of the entries from ``count`` on in mean log q/p of rows left out, less its error."""
    gains = np.zeros(len(weights))
    for fold in range(_FOLDS):
        out = np.arange(len(weights)) % _FOLDS == fold
        logs = []
        for columns in (ratios[:, :count], ratios):
            fitted_weights = weights[~out] / weights[~out].sum()
            share = _shares(columns[~out], fitted_weights, defensive, start[: columns.shape[1]], rounds)
            logs.append(np.log(defensive + columns[out] @ share))
        gains[out] = logs[1] - logs[0]
    mean = float(weights @ gains)
    return mean - math.sqrt(float(weights**2 @ (gains - mean) ** 2))


def _smooth_entry(group: Group, share: float, length: int) -> list[tuple[Group, float]]:
    """Return an entry and those that get a part of its share: its neighbours in time, its mirror image."""
    parts = [(group, share)]
    if len(group) == 1:
        row = next(iter(group))
        leaks = ((-1, _LEAK), (0, 1.0 - 2.0 * _LEAK), (1, _LEAK))
        parts = [({_move_atom(row, delay, length): 1.0}, leak * share) for delay, leak in leaks]
    if not next(iter(group))[5]:
        return parts
    mirrored = [
        ({(*row[:5], -row[5], row[6]): w for row, w in part.items()}, _MIRRORED * a) for part, a in parts
    ]
    return [(part, (1.0 - _MIRRORED) * a) for part, a in parts] + mirrored


def _move_atom(row: Row, delay: int, length: int) -> Row:
    """Return an atom shifted by ``delay`` of its strides; unchanged where that leaves the tape."""
    channel, first, last, decay, *rest = row
    by = delay * (1 if first == last else _stride(last - first + 1, decay))
    return (channel, first + by, last + by, decay, *rest) if first + by >= 1 and last + by < length else row


def _strongest(components: Sequence[tuple[float, list[Group]]]) -> list[Group]:
    """Return the strongest groups that widen a channel, raise it or lower it."""
    groups: dict[Any, Group] = {}
    for amount, (group,) in components:
        for row, part in group.items():
            sums = groups.setdefault((row[0], float(np.sign(row[5]))), {})
            sums[row] = sums.get(row, 0.0) + amount * part
    return sorted(groups.values(), key=lambda group: -sum(group.values()))[:_MOST_GROUPS]


def _channel(group: Group) -> int:
    return int(next(iter(group))[0])


def _component_ratios(components: Sequence[Sequence[Group]], tapes: Floats) -> Floats:
    """Return g/p (E, J) of components of one or two groups."""
    rows = list(dict.fromkeys(row for groups in components for group in groups for row in group))
    place = {row: a for a, row in enumerate(rows)}
    largest = math.exp(_LARGEST_LOG)
    single = np.exp(np.minimum(log_ratios(Atoms.of(rows), tapes), _LARGEST_LOG))

    def ratio(group: Group) -> Floats:
        weights = np.array(list(group.values()))
        return np.asarray(single[:, [place[row] for row in group]] @ (weights / weights.sum()))

    products = [math.prod(ratio(group) for group in groups) for groups in components]
    return np.asarray(np.minimum(np.stack(products, axis=1), largest))
