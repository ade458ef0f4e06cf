"""Atoms: small changes of a noise tape, each along one direction of one channel.

A direction is a unit vector v of a channel's numbers: one step; or a window, even or growing geometrically
towards its end, beside which the number of step 0 may have a share. Errors that persist are sums of this
form: a part that is drawn at the start and lasts, and a part that fades by a factor a step. Along it,
x = v·z has mean m and standard deviation s >= 1; across it the tape is as it was. So z + a v has this law for
standard normal z and a normal a of mean m and variance k = s^2 - 1, and the steps so far, over which v has
the squared length n, have the density ratio

    log g/p = (k x^2 + 2 m x - m^2 n) / (2 (1 + k n)) - log(1 + k n) / 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from avrare.protocols import Floats
from avrare.rollout.request import Integers

Row = tuple[float, ...]
"""Channel, first, last, decay, start, shift, scale of an atom."""
Group = dict[Row, float]
"""Atoms and their shares."""


@dataclass(frozen=True)
class Atoms:
    """A atoms.

    Attributes:
        channel: (A,).
        first: (A,) first step of the window.
        last: (A,) its last step.
        decay: (A,) factor of the direction per step before the last.
        start: (A,) share of step 0 in the squared length, beside the window.
        shift: (A,) mean along the direction.
        scale: (A,) standard deviation along it, at least 1.
    """

    channel: Integers
    first: Integers
    last: Integers
    decay: Floats
    start: Floats
    shift: Floats
    scale: Floats

    @staticmethod
    def of(rows: Sequence[Row]) -> Atoms:
        """Return atoms from rows of numbers in the order of the attributes."""
        table = np.array(rows, dtype=np.float64).reshape(len(rows), 7)
        if not np.isfinite(table).all():
            raise ValueError("an atom has a number that is not finite")
        whole = table[:, :3].astype(np.int64)
        return Atoms(*whole.T.copy(), *table[:, 3:].T.copy())

    @cached_property
    def rows(self) -> list[Row]:
        """Rows of numbers in the order of the attributes."""
        return list(zip(*(getattr(self, field.name).tolist() for field in fields(self)), strict=True))

    @property
    def size(self) -> int:
        """A."""
        return len(self.channel)

    def take(self, index: Integers) -> Atoms:
        """Return some of the atoms."""
        return Atoms(*(getattr(self, field.name)[index] for field in fields(self)))

    @cached_property
    def directions(self) -> tuple[Integers, Integers]:
        """An atom of each of the D directions, (D,), and the direction of each atom, (A,)."""
        shape = np.stack([self.channel, self.first, self.last, self.decay, self.start], axis=1)
        _, index, inverse = np.unique(shape, axis=0, return_index=True, return_inverse=True)
        return index, inverse.reshape(-1)

    def vectors(self, steps: int) -> Floats:
        """Return the directions (D, steps + 1) of unit length."""
        atoms = self.take(self.directions[0])
        first, last, decay, start = (
            column[:, None] for column in (atoms.first, atoms.last, atoms.decay, atoms.start)
        )
        t = np.arange(steps + 1)
        vectors = np.where((t >= first) & (t <= last), decay ** np.maximum(last - t, 0), 0.0)
        vectors *= np.sqrt((1.0 - start) / (vectors * vectors).sum(axis=1, keepdims=True))
        vectors[:, 0] += np.sqrt(atoms.start)
        return np.asarray(vectors)

    def logs(self, along: Floats, length: Floats) -> Floats:
        """Return log g/p from x and n of each atom, arrays whose last axis is A."""
        spread, m = self.scale * self.scale - 1.0, self.shift
        grown = 1.0 + spread * length
        # In place: the arrays of x are the large ones.
        logs = along * (0.5 * spread / grown)
        logs += m / grown
        logs *= along
        logs -= 0.5 * (m * m * length / grown + np.log(grown))
        return np.asarray(logs)


def log_ratios(atoms: Atoms, tapes: Floats) -> Floats:
    """Return log g/p (E, A) of tapes (E, steps + 1, noise_size) under each atom; not for weights."""
    index, direction = atoms.directions
    vectors = atoms.vectors(tapes.shape[1] - 1)
    channels = atoms.channel[index]
    along = np.empty((len(tapes), len(index)))
    for channel in np.unique(channels):
        here = np.flatnonzero(channels == channel)
        along[:, here] = tapes[:, :, channel] @ vectors[here].T
    return atoms.logs(along[:, direction], np.ones(1))
