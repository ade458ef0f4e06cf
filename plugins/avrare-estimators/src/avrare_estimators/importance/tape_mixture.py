"""Mixtures on the noise tape: each component changes one or two small parts of the tape and leaves the rest.

A part is an *atom*: one coordinate at one step that is widened (a normal law of a larger standard deviation,
which reaches both tails), or a channel whose mean is shifted over a window of steps, evenly or growing
geometrically towards its end. Its density ratio to the target is a sum over its own steps.
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
NO_ATOM = -1
Row = tuple[float, ...]
"""Channel, first, last, shift, decay, scale of an atom."""


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

    @property
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
    """A mixture of J components of one or two atoms (an ``avrare.rollout.tape_law.TapeProposal``).

    Attributes:
        atoms: A atoms.
        parts: (J, 2) atoms of each component; ``NO_ATOM`` where the second is missing.
        share: (J,) adding up to 1.
        shape: (steps + 1, noise_size) of a tape.
    """

    atoms: Atoms
    parts: Integers
    share: Floats
    shape: tuple[int, int]

    @staticmethod
    def frozen(atoms: Atoms, parts: Integers, share: Floats, shape: tuple[int, int]) -> TapeMixture:
        """Return the mixture in rounded numbers, without atoms that no component has."""
        rounded = np.round(share / share.sum(), _DIGITS)
        kept = rounded > 0.0
        used, index = np.unique(parts[kept], return_inverse=True)
        index = index.reshape(-1, 2) - (1 if used[0] == NO_ATOM else 0)
        chosen = atoms.take(used[used != NO_ATOM])
        final = Atoms(
            chosen.channel, chosen.first, chosen.last, np.round(chosen.shift, _DIGITS),
            np.round(chosen.decay, _DIGITS), np.round(chosen.scale, _DIGITS),
        )  # fmt: skip
        return TapeMixture(final, index, rounded[kept], shape)

    @property
    def terms(self) -> int:
        """A, the number of sums that the density needs."""
        return self.atoms.size

    @cached_property
    def digest(self) -> str:
        """16 hexadecimal digits of the content."""
        text = json.dumps(self.to_dict(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def choose(self, uniform: Floats) -> Integers:
        """Return the component (M,) of rows with these uniform numbers."""
        ends = np.cumsum(self.share)
        return np.minimum(np.searchsorted(ends, uniform * ends[-1], side="right"), len(ends) - 1)

    def transform(self, noise: Floats, component: Integers, first: int) -> None:
        """Change standard normals (M, K, noise_size) of the steps from ``first`` on into the rows' law."""
        for column in (0, 1):
            atom = self.parts[component, column]
            for k in range(noise.shape[1]):
                t = first + k
                rows = np.flatnonzero(
                    (atom != NO_ATOM) & (self.atoms.first[atom] <= t) & (self.atoms.last[atom] >= t)
                )
                own = self.atoms.take(atom[rows])
                noise[rows, k, own.channel] = own.mean(t) + own.scale * noise[rows, k, own.channel]

    def evidence(self, noise: Floats, step: int) -> tuple[Integers, Floats]:
        """Return the atoms at a step and log g/p (M, k) of its noise (M, noise_size) under each."""
        active = np.flatnonzero((self.atoms.first <= step) & (self.atoms.last >= step))
        atoms = self.atoms.take(active)
        x, mean, precision = noise[:, atoms.channel], atoms.mean(step), atoms.scale**-2
        return active, (mean * x - 0.5 * mean * mean) * precision + (
            0.5 * (1.0 - precision) * x * x - np.log(atoms.scale)
        )

    def components(self, sums: Floats) -> Floats:
        """Return the log of share times g/p (M, J) of each component, from the sums (M, A)."""
        padded = np.concatenate([sums, np.zeros((len(sums), 1))], axis=1)  # NO_ATOM is the last
        logs = padded[:, self.parts[:, 0]] + padded[:, self.parts[:, 1]]
        return np.ascontiguousarray(logs + np.log(self.share / self.share.sum()))

    def log_ratio(self, sums: Floats) -> Floats:
        """Return log p/q (M,) from the sums (M, A) over the steps."""
        logs = self.components(sums)
        top = logs.max(axis=1)
        # Contiguous along the axis of the sum: no row's bits depend on how many there are.
        return np.asarray(-(top + np.log(np.exp(logs - top[:, None]).sum(axis=1))))

    def sums(self, tapes: Floats) -> Floats:
        """Return the sums (M, A) over complete tapes (M, steps + 1, noise_size)."""
        found = np.zeros((len(tapes), self.terms))
        for step in range(self.shape[0]):
            active, values = self.evidence(tapes[:, step], step)
            found[:, active] += values
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return the mixture as JSON data."""
        return {
            "steps": self.shape[0] - 1,
            "noise_size": self.shape[1],
            "atoms": [dict(zip(_FIELDS, row, strict=True)) for row in self.atoms.rows],
            "components": [
                {"share": share, "atoms": [part for part in parts if part != NO_ATOM]}
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
            parts = np.array([[*one["atoms"], NO_ATOM][:2] for one in content["components"]], dtype=np.int64)
            share = np.array([float(one["share"]) for one in content["components"]])
            mixture = TapeMixture(atoms, parts, share, (content["steps"] + 1, content["noise_size"]))
            mixture._check()
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise UsageError(
                f"a learned proposal is damaged: {type(error).__name__}: {error}", "learn it again"
            ) from None
        return mixture

    def _check(self) -> None:
        a, (rows, channels) = self.atoms, self.shape
        inside = (a.first >= 0) & (a.first <= a.last) & (a.last < rows) & (0 <= a.channel) & (a.channel < channels)
        numbers = np.isfinite([a.shift, a.decay, a.scale]).all() and (a.scale > 0).all() and (a.decay > 0).all()
        known = (self.parts[:, 0] >= 0).all() and (self.parts < a.size).all() and (self.parts >= NO_ATOM).all()
        if not (inside.all() and numbers and known and len(self.share) and (self.share > 0).all()):
            raise ValueError("an atom lies outside the tape, or a number is out of range")


_FIELDS = tuple(field.name for field in fields(Atoms))


def blend(mixtures: Sequence[TapeMixture], shares: Sequence[float]) -> TapeMixture:
    """Return the mixture of mixtures."""
    rows: dict[Row, int] = {}
    total: dict[tuple[int, int], float] = {}
    for mixture, weight in zip(mixtures, shares, strict=True):
        place = np.array([rows.setdefault(row, len(rows)) for row in mixture.atoms.rows] + [NO_ATOM])
        for parts, share in zip(place[mixture.parts].tolist(), mixture.share, strict=True):
            key = (parts[0], parts[1])
            total[key] = total.get(key, 0.0) + weight * float(share)
    parts = np.array(list(total), dtype=np.int64)
    return TapeMixture.frozen(Atoms.of(list(rows)), parts, np.array(list(total.values())), mixtures[0].shape)
