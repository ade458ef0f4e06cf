"""Mixtures on the noise tape: each component changes one or two small parts of the tape and leaves the rest.

What changes a part is an atom (``atoms``). The density needs one sum over the steps for each direction.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.rollout.request import Integers
from avrare_estimators.common.tapes.atoms import Atoms, Group, Row, log_ratios

_DIGITS = 6
"""Decimals of a frozen number: rounding of the fit must not reach the rollouts."""
_LEAST_SHARE = 1e-3
"""Least share of a component, over the largest."""
_BLOCK = 2**20
"""Atoms of all rows that are weighed at once."""
NONE = -1


@dataclass(frozen=True)
class TapeMixture:
    """A mixture of J components, each a group of atoms or two independent ones (a ``TapeProposal``).

    A group draws one of its atoms. Two groups of a component have different channels.

    Attributes:
        atoms: A atoms.
        groups: Atoms of each of G groups and their shares, which add up to 1.
        parts: (J, 2) groups of each component; ``NONE`` where the second is missing.
        share: (J,) adding up to 1.
        shape: (steps + 1, noise_size) of a tape.
        learned: The part that was learned, where others are beside it; None: all of it.
    """

    atoms: Atoms
    groups: tuple[tuple[Integers, Floats], ...]
    parts: Integers
    share: Floats
    shape: tuple[int, int]
    learned: TapeMixture | None = None

    @staticmethod
    def freeze(components: Sequence[tuple[float, Sequence[Group]]], shape: tuple[int, int]) -> TapeMixture:
        """Return a mixture of components (share, one or two groups) in rounded numbers, without tiny ones.

        A component of one group is the same law as one component for each of its atoms, and becomes
        them: atoms that several groups share are counted once.
        """
        most = max(share for share, _ in components)
        alone: Group = {}
        pairs = []
        for share, groups in components:
            if share < _LEAST_SHARE * most:
                continue
            if len(groups) > 1:
                pairs.append((share, [_round_group(group) for group in groups]))
                continue
            total = sum(groups[0].values())
            for row, weight in groups[0].items():
                alone[row] = alone.get(row, 0.0) + share * weight / total
        single = [(share, [{row: 1.0}]) for row, share in _round_group(_without_least(alone)).items()]
        return TapeMixture.of([*single, *pairs], shape)

    @staticmethod
    def of(
        components: Sequence[tuple[float, Sequence[Group]]],
        shape: tuple[int, int],
        learned: TapeMixture | None = None,
    ) -> TapeMixture:
        """Return a mixture of components (share, one or two groups) in rounded numbers."""
        total = sum(share for share, _ in components)
        rows: dict[Row, int] = {}
        groups: dict[tuple[tuple[int, ...], tuple[float, ...]], int] = {}
        parts, shares = [], []
        for share, groups_of_component in components:
            places = []
            for group in groups_of_component:
                size = sum(group.values())
                weights = {row: round(weight / size, _DIGITS) for row, weight in group.items()}
                positive = {row: weight for row, weight in weights.items() if weight > 0.0}
                index = tuple(rows.setdefault(row, len(rows)) for row in positive)
                places.append(groups.setdefault((index, tuple(positive.values())), len(groups)))
            parts.append([*places, NONE][:2])
            shares.append(max(round(share / total, _DIGITS), 10.0**-_DIGITS))
        built = tuple((np.array(index), np.array(weights)) for index, weights in groups)
        return TapeMixture(Atoms.of(list(rows)), built, np.array(parts), np.array(shares), shape, learned)

    @property
    def components(self) -> list[tuple[float, list[Group]]]:
        """Share and groups of each component."""
        rows = self.atoms.rows
        groups = [
            {rows[a]: w for a, w in zip(index.tolist(), weights.tolist(), strict=True)}
            for index, weights in self.groups
        ]
        return [
            (share, [groups[part] for part in parts if part != NONE])
            for share, parts in zip(self.share.tolist(), self.parts.tolist(), strict=True)
        ]

    @property
    def terms(self) -> int:
        """Number of sums that the density needs: x of each of D directions, and the number of steps."""
        return len(self.atoms.directions[0]) + 1

    @cached_property
    def _vectors(self) -> Floats:
        """Directions (steps + 1, D)."""
        return np.ascontiguousarray(self.atoms.vectors(self.shape[0] - 1).T)

    @cached_property
    def _lengths(self) -> Floats:
        """Squared lengths (steps + 2, D) of the directions, by number of steps."""
        squares = np.cumsum(self._vectors**2, axis=0)
        return np.concatenate([np.zeros_like(squares[:1]), squares])

    @cached_property
    def _active(self) -> list[tuple[Integers, Integers, Floats]]:
        """Sums that a step changes, and of the directions among them channels and numbers (k, 1)."""
        channel, count = self.atoms.channel[self.atoms.directions[0]], self._vectors.shape[1]
        changes = []
        for vector in self._vectors:
            directions = np.flatnonzero(vector)
            changes.append((np.append(directions, count), channel[directions], vector[directions, None]))
        return changes

    @cached_property
    def _alone(self) -> Integers:
        """Atom of each group (G,) that consists of a single atom; ``NONE`` for other groups."""
        return np.array([index[0] if len(index) == 1 else NONE for index, _ in self.groups])

    @cached_property
    def digest(self) -> str:
        """16 hexadecimal digits of the content."""
        text = json.dumps(self.to_dict(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def choose(self, uniform: Floats, sums: Floats | None = None) -> NDArray[np.void]:
        """Return atoms and amounts, a record array (M, 2), of rows with these uniform numbers (M, 3).

        The atom is ``NONE`` without a second. With ``sums`` (M, D + 1) all is drawn given the steps
        so far.
        """
        logs = None if sums is None else self.atom_logs(sums)
        picks = uniform[:, 0]
        if logs is None:
            component, rest = _pick(self.share, picks)
        else:
            component, rest = _pick_by_row(self.component_logs(logs), picks)
        chosen = np.zeros((len(uniform), 2), [("atom", np.int64), ("amount", np.float64)])
        chosen["atom"] = NONE
        for column in (0, 1):
            group = self.parts[component, column]
            chosen["atom"][:, column] = np.where(group == NONE, NONE, self._alone[group])
            for g in np.unique(group[(group != NONE) & (self._alone[group] == NONE)]):
                rows = np.flatnonzero(group == g)
                index, weights = self.groups[g]
                if logs is None:
                    place, rest[rows] = _pick(weights, rest[rows])
                else:
                    place, rest[rows] = _pick_by_row(logs[np.ix_(rows, index)] + np.log(weights), rest[rows])
                chosen["atom"][rows, column] = index[place]
        chosen["amount"] = self._amounts(chosen["atom"], uniform, sums)
        return chosen

    def _amounts(self, atom: Integers, uniform: Floats, sums: Floats | None) -> Floats:
        """Return the amounts (M, 2) along the directions of atoms, given the steps so far."""
        radius, angle = np.sqrt(-2.0 * np.log(uniform[:, 1])), 2.0 * np.pi * uniform[:, 2]
        normal = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        atoms = self.atoms.take(atom)  # of NONE, too: never used
        spread = atoms.scale**2 - 1.0
        if sums is None:
            return np.asarray(atoms.shift + np.sqrt(spread) * normal)
        direction = self.atoms.directions[1][atom]
        along = np.take_along_axis(sums, direction, axis=1)
        grown = 1.0 + spread * self._lengths[_steps_of(sums)[:, None], direction]
        return np.asarray((atoms.shift + spread * along) / grown + np.sqrt(spread / grown) * normal)

    def transform(self, noise: Floats, chosen: NDArray[np.void], first: int) -> None:
        """Change standard normals (M, K, noise_size) of the steps from ``first`` on into the rows' law."""
        for column in range(chosen.shape[1]):
            atom, amount = chosen["atom"][:, column], chosen["amount"][:, column]
            direction = self.atoms.directions[1][atom]
            for k in range(noise.shape[1]):
                number = np.where(atom == NONE, 0.0, self._vectors[first + k, direction])
                rows = np.flatnonzero(number)
                noise[rows, k, self.atoms.channel[atom[rows]]] += amount[rows] * number[rows]

    def evidence(self, noise: Floats, step: int) -> tuple[Integers, Floats]:
        """Return the sums that a step changes, and by how much (k, M), with noise (M, noise_size)."""
        active, channel, number = self._active[step]
        values = np.ones((len(active), len(noise)))
        np.multiply(noise.T[channel], number, out=values[:-1])
        return active, values

    def atom_logs(self, sums: Floats) -> Floats:
        """Return log g/p (M, A) under each atom of the steps over which the sums (M, D + 1) were taken."""
        direction = self.atoms.directions[1]
        length = self._lengths[_steps_of(sums)]
        return self.atoms.logs(sums[:, direction], length[:, direction])

    def component_logs(self, atom_logs: Floats) -> Floats:
        """Return the log of share times g/p (M, J) of each component, from those (M, A) of the atoms."""
        first = self._alone[self.parts[:, 0]]
        logs = atom_logs[:, first]
        paired = np.flatnonzero((first == NONE) | (self.parts[:, 1] != NONE))
        logs_of_group = {
            g: self._group_logs(atom_logs, g) for g in np.unique(self.parts[paired]) if g != NONE
        }
        for j in paired:
            logs[:, j] = sum(logs_of_group[g] for g in self.parts[j] if g != NONE)
        logs += np.log(self.share / self.share.sum())
        return logs

    def _group_logs(self, atom_logs: Floats, group: int) -> Floats:
        index, weights = self.groups[group]
        return _log_sum(atom_logs[:, index] + np.log(weights / weights.sum()))

    def log_ratio(self, sums: Floats) -> Floats:
        """Return log p/q (M,) from the sums (M, D + 1) over the steps."""
        return self._by_blocks(sums, self.atom_logs)

    def log_ratio_of(self, tapes: Floats) -> Floats:
        """Return log p/q (M,) of complete tapes; for learning, not for weights."""
        return self._by_blocks(tapes, partial(log_ratios, self.atoms))

    def _by_blocks(self, rows: Floats, atom_logs: Callable[[Floats], Floats]) -> Floats:
        """Return log p/q (M,) of rows, a few at a time: there are many atoms."""
        size = max(1, _BLOCK // self.atoms.size)
        blocks = (rows[begin : begin + size] for begin in range(0, max(1, len(rows)), size))
        return -np.concatenate([_log_sum(self.component_logs(atom_logs(block))) for block in blocks])

    def to_dict(self) -> dict[str, Any]:
        """Return the mixture as JSON data."""
        return {
            "steps": self.shape[0] - 1,
            "noise_size": self.shape[1],
            "atoms": [dict(zip(_FIELDS, row, strict=True)) for row in self.atoms.rows],
            "groups": [
                {"atoms": index.tolist(), "shares": weights.tolist()} for index, weights in self.groups
            ],
            "components": [
                {"share": share, "groups": [part for part in parts if part != NONE]}
                for share, parts in zip(self.share.tolist(), self.parts.tolist(), strict=True)
            ],
        }

    @staticmethod
    def from_dict(content: Mapping[str, Any]) -> TapeMixture:
        """Return the mixture of JSON data.

        Raises:
            UsageError: The data are damaged.
        """
        try:
            atoms = Atoms.of([tuple(float(atom[name]) for name in _FIELDS) for atom in content["atoms"]])
            groups = tuple(
                (np.array(entry["atoms"], dtype=np.int64), np.array(entry["shares"], dtype=np.float64))
                for entry in content["groups"]
            )
            parts = np.array(
                [[*entry["groups"], NONE][:2] for entry in content["components"]], dtype=np.int64
            )
            share = np.array([float(entry["share"]) for entry in content["components"]])
            shape = (int(content["steps"]) + 1, int(content["noise_size"]))
            mixture = TapeMixture(atoms, groups, parts, share, shape)
            mixture._check()
        except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
            raise UsageError(
                f"a learned proposal is damaged: {type(error).__name__}: {error}", "learn it again"
            ) from None
        return mixture

    def _check(self) -> None:
        a, (rows, channels) = self.atoms, self.shape
        inside = (a.first >= 0) & (a.first <= a.last) & (a.last < rows)
        inside &= (a.channel >= 0) & (a.channel < channels) & (a.scale >= 1.0) & (a.decay > 0)
        inside &= (a.start >= 0) & ((a.start == 0) | (a.first > 0) & (a.start < 1.0))
        numbers = bool(np.isfinite([a.shift, a.decay, a.start, a.scale]).all())
        fits = all(i.ndim == w.ndim == 1 for i, w in self.groups) and self.parts.ndim == 2
        fits = fits and all(
            (i >= 0).all() and (i < a.size).all() and len(i) == len(w) > 0 for i, w in self.groups
        )
        fits &= bool((self.parts[:, 0] >= 0).all() and (self.parts[:, 1] >= NONE).all())
        fits &= bool((self.parts < len(self.groups)).all())
        fits &= all(
            (w > 0).all() and np.isfinite(w).all() for w in (*(w for _, w in self.groups), self.share)
        )
        if not (inside.all() and numbers and fits and len(self.share)):
            raise ValueError("an atom lies outside the tape, or a number is out of range")
        channels_of = [set(a.channel[index].tolist()) for index, _ in self.groups]
        if any(k != NONE and channels_of[g] & channels_of[k] for g, k in self.parts.tolist()):
            raise ValueError("two groups of a component share a channel")


_FIELDS = tuple(field.name for field in fields(Atoms))


def blend(mixtures: Sequence[TapeMixture], shares: Sequence[float]) -> TapeMixture:
    """Return the mixture of mixtures."""
    total: dict[Any, float] = {}
    for mixture, weight in zip(mixtures, shares, strict=True):
        for share, groups in mixture.components:
            key = tuple(tuple(group.items()) for group in groups)
            total[key] = total.get(key, 0.0) + weight * share
    return TapeMixture.freeze(
        [(share, [dict(group) for group in key]) for key, share in total.items()], mixtures[0].shape
    )


def _without_least(shares: Group) -> Group:
    """Return shares without the least ones, which together are at most ``_DROPPED`` of all."""
    order = sorted(shares, key=shares.__getitem__)
    lost = np.cumsum([shares[row] for row in order])
    # the least atoms are left out, 2 % of all
    dropped = set(order[: int(np.searchsorted(lost, 0.02 * lost[-1]))]) if order else set()
    return {row: share for row, share in shares.items() if row not in dropped}


def _steps_of(sums: Floats) -> Integers:
    """Return the number of steps (M,) over which sums were taken."""
    return sums[:, -1].astype(np.int64)


def _round_group(group: Group) -> Group:
    """Return a group whose atoms have rounded numbers."""
    rounded: Group = {}
    for row, weight in group.items():
        near = (*row[:3], *(round(value, _DIGITS) for value in row[3:]))
        rounded[near] = rounded.get(near, 0.0) + weight
    return rounded


def _pick(shares: Floats, uniform: Floats) -> tuple[Integers, Floats]:
    """Return the place of each uniform number among shares, and where it lies inside, uniform again."""
    ends = np.cumsum(shares) / shares.sum()
    place = np.minimum(np.searchsorted(ends, uniform, side="right"), len(ends) - 1)
    begin = ends[place] - shares[place] / shares.sum()
    return place, np.clip((uniform - begin) / (ends[place] - begin), 0.0, 1.0 - 2.0**-53)


def _pick_by_row(logs: Floats, uniform: Floats) -> tuple[Integers, Floats]:
    """Return as ``_pick`` does, with log shares (M, K) of each row's own that need not add up to 1."""
    shares = np.exp(logs - logs.max(axis=1, keepdims=True))
    ends = np.cumsum(shares, axis=1)
    position = uniform * ends[:, -1]
    place = np.minimum((ends <= position[:, None]).sum(axis=1), shares.shape[1] - 1)
    rows = np.arange(len(uniform))
    width = shares[rows, place]
    rest = (position - (ends[rows, place] - width)) / np.where(width > 0.0, width, 1.0)
    return place, np.clip(rest, 0.0, 1.0 - 2.0**-53)


def _log_sum(logs: Floats) -> Floats:
    """Return log of the sum of exponentials (M,) over axis 1."""
    top = logs.max(axis=1)
    # Contiguous along the axis of the sum: no row's bits depend on how many there are.
    grown = np.ascontiguousarray(np.exp(logs - top[:, None]))
    return np.asarray(top + np.log(grown.sum(axis=1)))
