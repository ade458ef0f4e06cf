"""Noise tape: standard normals addressed by (seed, run, stage, particle, step).

Philox-4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011) is a function from a
counter and a key to random bits. The key holds seed and run; the counter holds stage, particle, step and the
channel. Any number of any tape can therefore be drawn on its own, in any order, by any worker.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from avrare.base.errors import UsageError
from avrare.base.philox import philox, to_uniform

Floats = NDArray[np.float64]


@lru_cache(maxsize=65536)
def _run_key(seed: int, run: int) -> tuple[int, int]:
    words = np.random.SeedSequence(seed, spawn_key=(run,)).generate_state(2, np.uint32)
    return int(words[0]), int(words[1])


class NoiseSource:
    """Source of all noise tapes of one estimate.

    Args:
        seed: Non-negative integer.
        noise_size: Numbers per step and particle.
        first_run: Run of the seed that this source calls run 0.

    Raises:
        UsageError: The seed is negative or no integer.
    """

    def __init__(self, seed: int, noise_size: int, first_run: int = 0) -> None:
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
            raise UsageError(f"seed must be an integer of at least 0, not {seed!r}")
        self.seed = int(seed)
        self.noise_size = noise_size
        self.first_run = first_run

    def normals(self, run: ArrayLike, stage: ArrayLike, particle: ArrayLike, step: ArrayLike) -> Floats:
        """Return standard normals (*S, noise_size) of addresses that broadcast to the shape S."""
        shape = np.broadcast_shapes(*map(np.shape, (run, stage, particle, step)))
        # a block of more numbers takes too much memory; a single tape is drawn whole
        rows = 2**17 // max(math.prod(shape[1:]) * self.noise_size, 1)
        if not shape or shape[0] <= max(rows, 1):
            return self._block(run, stage, particle, step)
        address = [np.broadcast_to(part, shape) for part in (run, stage, particle, step)]
        numbers = np.empty((*shape, self.noise_size))
        for begin in range(0, shape[0], max(rows, 1)):
            part = slice(begin, begin + max(rows, 1))
            numbers[part] = self._block(*(axis[part] for axis in address))
        return numbers

    def _block(self, run: ArrayLike, stage: ArrayLike, particle: ArrayLike, step: ArrayLike) -> Floats:
        count = (self.noise_size + 1) // 2
        first, second = self._uniforms(run, stage, particle, step, count)
        radius = np.sqrt(-2.0 * np.log(first))
        angle = (2.0 * np.pi) * second
        if self.noise_size == 1:
            return np.asarray(radius * np.cos(angle))
        both = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
        return np.ascontiguousarray(both.reshape(*first.shape[:-1], 2 * count)[..., : self.noise_size])

    def choices(
        self, run: ArrayLike, stage: ArrayLike, particle: ArrayLike, count: int | None = None
    ) -> Floats:
        """Return uniforms in (0, 1) for an estimator's own choices: one for each address, or (*S, count)."""
        # the largest step of an address, which no tape reaches, is for choices
        pairs = self._uniforms(run, stage, particle, 0xFFFFFFFF, ((count or 1) + 1) // 2)
        if count is None:
            return pairs[0][..., 0]
        return np.concatenate(pairs, axis=-1)[..., :count]

    def _uniforms(
        self, run: ArrayLike, stage: ArrayLike, particle: ArrayLike, step: ArrayLike, count: int
    ) -> tuple[Floats, Floats]:
        # Two arrays (*S, count) of uniforms in the open interval (0, 1), 53 bits each.
        runs, inverse = np.unique(run, return_inverse=True)
        keys = np.array(
            [_run_key(self.seed, self.first_run + int(r)) for r in runs], dtype=np.uint64
        ).reshape(-1, 2)
        keys = keys[inverse.reshape(np.shape(run))]
        address = [np.asarray(part, dtype=np.uint64)[..., None] for part in (step, particle, stage)]
        c0, c1, c2, c3 = np.broadcast_arrays(np.arange(count, dtype=np.uint64), *address, keys[..., :1])[:4]
        words = philox((c0, c1, c2, c3), (keys[..., :1], keys[..., 1:]))
        return to_uniform(words[0], words[1]), to_uniform(words[2], words[3])
