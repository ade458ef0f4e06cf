"""Mixtures on the noise tape: each component changes one or two small parts of the tape and leaves the rest.

What changes a part is an *atom*: one coordinate at one step that is widened (a normal law of a larger
standard deviation, which reaches both tails), or a channel whose mean is shifted over a window of steps,
evenly or growing geometrically towards its end. Its density ratio to the target is a sum over its own steps.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.rollout.request import Integers

_DIGITS = 6
"""Decimals of a frozen number: rounding of the fit must not reach the rollouts."""
_LEAST_SHARE = 1e-3
"""Least share of a component, over the largest."""
NONE = -1
Row = tuple[float, ...]
"""Channel, first, last, shift, decay, scale of an atom."""
Group = dict[Row, float]
"""Atoms and their shares."""


@dataclass(frozen=True)
class Atoms:
    """A atoms; each makes z of a channel and step t normal with mean shift * decay^(last - t) and its scale.

    Attributes:
        channel: (A,).
        first: (A,) first step.
        last: (A,) last step.
        shift: (A,) mean at the last step.
        decay: (A,) factor of the mean per step before it.
        scale: (A,) standard deviation.
    """

    channel: Integers
    first: Integers
    last: Integers
    shift: Floats
    decay: Floats
    scale: Floats

    @staticmethod
    def of(rows: Sequence[Row]) -> Atoms:
        """Return atoms from rows (channel, first, last, shift, decay, scale)."""
        table = np.array(rows, dtype=np.float64).reshape(len(rows), 6)
        whole = table[:, :3].astype(np.int64)
        return Atoms(*whole.T.copy(), *table[:, 3:].T.copy())

    @cached_property
    def rows(self) -> list[Row]:
        """Rows (channel, first, last, shift, decay, scale)."""
        return list(zip(*(getattr(self, field.name).tolist() for field in fields(self)), strict=True))

    @property
    def size(self) -> int:
        """A."""
        return len(self.channel)

    def take(self, index: Any) -> Atoms:
        """Return some of the atoms."""
        return Atoms(*(getattr(self, field.name)[index] for field in fields(self)))

    def mean(self, step: Any) -> Floats:
        """Return the means at a step (or steps that broadcast) inside the atoms."""
        return np.asarray(self.shift * self.decay ** (self.last - step))


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
    """

    atoms: Atoms
    groups: tuple[tuple[Integers, Floats], ...]
    parts: Integers
    share: Floats
    shape: tuple[int, int]

    @staticmethod
    def frozen(components: Sequence[tuple[float, Sequence[Group]]], shape: tuple[int, int]) -> TapeMixture:
        """Return a mixture of components (share, one or two groups) in rounded numbers, without tiny ones."""
        total = sum(share for share, _ in components)
        most = max(share for share, _ in components)
        rows: dict[Row, int] = {}
        groups: dict[tuple[tuple[int, ...], tuple[float, ...]], int] = {}
        parts, shares = [], []
        for share, own in components:
            if share < _LEAST_SHARE * most:
                continue
            places = []
            for group in own:
                index = tuple(rows.setdefault(_rounded(row), len(rows)) for row in group)
                weights = np.array(list(group.values()))
                key = (index, tuple(np.round(weights / weights.sum(), _DIGITS).tolist()))
                places.append(groups.setdefault(key, len(groups)))
            parts.append([*places, NONE][:2])
            shares.append(round(share / total, _DIGITS))
        built = tuple((np.array(index), np.array(weights)) for index, weights in groups)
        return TapeMixture(Atoms.of(list(rows)), built, np.array(parts), np.array(shares), shape)

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
        """A, the number of sums that the density needs."""
        return self.atoms.size

    @cached_property
    def _densities(self) -> list[tuple[Any, ...]]:
        """Log g/p at each step: atoms there, channels, linear and constant terms, wide atoms, squares."""
        found = []
        for step in range(self.shape[0]):
            active = np.flatnonzero((self.atoms.first <= step) & (self.atoms.last >= step))
            atoms = self.atoms.take(active)
            mean, precision = atoms.mean(step), atoms.scale**-2
            wide = np.flatnonzero(atoms.scale != 1.0)
            constant = 0.5 * mean * mean * precision + np.log(atoms.scale)
            columns = (mean * precision)[:, None], constant[:, None]
            square = 0.5 * (1.0 - precision[wide, None])
            found.append((active, atoms.channel, *columns, wide, square))
        return found

    @cached_property
    def digest(self) -> str:
        """16 hexadecimal digits of the content."""
        text = json.dumps(self.to_dict(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def choose(self, uniform: Floats, sums: Floats | None = None) -> Integers:
        """Return the atoms (M, 2) of rows with these uniform numbers; ``NONE`` where there is no second.

        With ``sums`` (M, A) they are drawn given the steps so far.
        """
        component, rest = _pick(self.share, uniform) if sums is None else self._pick_given(sums, uniform)
        chosen = np.full((len(uniform), 2), NONE)
        for column in (0, 1):
            group = self.parts[component, column]
            for g in np.unique(group[group != NONE]):
                own = np.flatnonzero(group == g)
                index, weights = self.groups[g]
                if sums is None:
                    place, rest[own] = _pick(weights, rest[own])
                else:
                    place, rest[own] = _pick_by_row(sums[np.ix_(own, index)] + np.log(weights), rest[own])
                chosen[own, column] = index[place]
        return chosen

    def _pick_given(self, sums: Floats, uniform: Floats) -> tuple[Integers, Floats]:
        return _pick_by_row(self.component_logs(sums), uniform)

    def transform(self, noise: Floats, chosen: Integers, first: int) -> None:
        """Change standard normals (M, K, noise_size) of the steps from ``first`` on into the rows' law."""
        starts, ends = np.append(self.atoms.first, 1), np.append(self.atoms.last, 0)  # NONE is the last
        for atom in chosen.T:
            for k in range(noise.shape[1]):
                t = first + k
                rows = np.flatnonzero((starts[atom] <= t) & (ends[atom] >= t))
                own = self.atoms.take(atom[rows])
                noise[rows, k, own.channel] = own.mean(t) + own.scale * noise[rows, k, own.channel]

    def evidence(self, noise: Floats, step: int) -> tuple[Integers, Floats]:
        """Return the atoms at a step and log g/p (k, M) of its noise (M, noise_size) under each."""
        active, channel, linear, constant, wide, square = self._densities[step]
        x = noise.T[channel]
        values = x * linear - constant
        values[wide] += square * x[wide] ** 2
        return active, values

    def component_logs(self, sums: Floats) -> Floats:
        """Return the log of share times g/p (M, J) of each component, from the sums (M, A)."""
        padded = np.zeros((len(sums), len(self.groups) + 1))  # NONE is the last
        for g, (index, weights) in enumerate(self.groups):
            logs = sums[:, index] + np.log(weights / weights.sum())
            padded[:, g] = logs[:, 0] if len(index) == 1 else _log_sum(logs)
        logs = padded[:, self.parts[:, 0]] + padded[:, self.parts[:, 1]]
        return np.asarray(logs + np.log(self.share / self.share.sum()))

    def log_ratio(self, sums: Floats) -> Floats:
        """Return log p/q (M,) from the sums (M, A) over the steps."""
        return -_log_sum(self.component_logs(sums))

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
                (np.array(one["atoms"], dtype=np.int64), np.array(one["shares"], dtype=np.float64))
                for one in content["groups"]
            )
            parts = np.array([[*one["groups"], NONE][:2] for one in content["components"]], dtype=np.int64)
            share = np.array([float(one["share"]) for one in content["components"]])
            shape = (int(content["steps"]) + 1, int(content["noise_size"]))
            mixture = TapeMixture(atoms, groups, parts, share, shape)
            mixture._check()
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise UsageError(
                f"a learned proposal is damaged: {type(error).__name__}: {error}", "learn it again"
            ) from None
        return mixture

    def _check(self) -> None:
        a, (rows, channels) = self.atoms, self.shape
        inside = (a.first >= 0) & (a.first <= a.last) & (a.last < rows)
        inside &= (a.channel >= 0) & (a.channel < channels) & (a.scale > 0) & (a.decay > 0)
        numbers = bool(np.isfinite([a.shift, a.decay, a.scale]).all())
        known = all((i >= 0).all() and (i < a.size).all() and len(i) == len(w) > 0 for i, w in self.groups)
        known &= bool((self.parts[:, 0] >= 0).all() and (self.parts[:, 1] >= NONE).all())
        known &= bool((self.parts < len(self.groups)).all() and all((w > 0).all() for _, w in self.groups))
        if not (inside.all() and numbers and known and len(self.share) and (self.share > 0).all()):
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
    return TapeMixture.frozen(
        [(share, [dict(group) for group in key]) for key, share in total.items()], mixtures[0].shape
    )


def _rounded(row: Row) -> Row:
    return (*row[:3], *(round(value, _DIGITS) for value in row[3:]))


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
    wanted = uniform * ends[:, -1]
    place = np.minimum((ends <= wanted[:, None]).sum(axis=1), shares.shape[1] - 1)
    rows = np.arange(len(uniform))
    width = shares[rows, place]
    rest = (wanted - (ends[rows, place] - width)) / np.where(width > 0.0, width, 1.0)
    return place, np.clip(rest, 0.0, 1.0 - 2.0**-53)


def _log_sum(logs: Floats) -> Floats:
    """Return log of the sum of exponentials (M,) over axis 1."""
    top = logs.max(axis=1)
    # Contiguous along the axis of the sum: no row's bits depend on how many there are.
    grown = np.ascontiguousarray(np.exp(logs - top[:, None]))
    return np.asarray(top + np.log(grown.sum(axis=1)))
