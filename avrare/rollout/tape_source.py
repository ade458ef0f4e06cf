"""Noise of a request: drawn from addresses in blocks of steps, or given; transformed and weighed by a law."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import CHOICES, FROM_START, Integers, Request, TapeProposal


class TapeDrawer:
    """Noise of a request, drawn in blocks of steps, and log p/q of the numbers handed out.

    Attributes:
        sums: (A, M) sums that the density of the request's proposal needs, over the steps of each row.
    """

    def __init__(self, noise: NoiseSource, request: Request, steps: int) -> None:
        self.noise, self.request, self.steps = noise, request, steps
        self._block_start = 0
        self._block: Floats = np.zeros((0, 0, 0))
        law = request.tape_law
        self.sums = np.zeros((law.terms if law is not None else 0, request.rows))
        self._chosen: NDArray[Any] | None = None
        if law is None:
            return
        if request.evidence is not None:
            self.sums = request.evidence.T.copy(order="C")  # it grows; the request must not
        elif (request.start != FROM_START).any():
            raise ValueError("rows that start later than at the beginning need the evidence of their steps")
        if request.tape is None:
            uniform = noise.choices(request.run, request.stage, request.particle, CHOICES)
            self._chosen = law.choose(uniform, request.evidence)

    def __call__(self, rows: Integers, t: int) -> Floats:
        """Return noise (len(rows), noise_size) of step ``t``, which never decreases between calls."""
        noise = self._numbers(rows, t)
        if self.request.tape_law is not None:
            terms, values = self.request.tape_law.evidence(noise, t)
            if len(rows) == self.request.rows:
                self.sums[terms] += values
            else:
                self.sums[np.ix_(terms, rows)] += values
        return noise

    def log_ratio(self) -> Floats:
        """Return log p/q (M,) of each row's steps."""
        law = self.request.tape_law
        return law.log_ratio(self.sums.T) if law is not None else np.zeros(self.request.rows)

    def _numbers(self, rows: Integers, t: int) -> Floats:
        if self.request.tape is not None:
            return np.ascontiguousarray(self.request.tape[rows, t])
        if not self._block_start <= t < self._block_start + self._block.shape[1]:
            self._draw(t)
        return np.asarray(self._block[rows, t - self._block_start])

    def _draw(self, t: int) -> None:
        request, size = self.request, max(self.noise.noise_size, 1)
        # at most 65,536 numbers at once
        count = int(np.clip(2**16 // (request.rows * size), 1, self.steps + 1 - t))
        started = slice(0, int(np.searchsorted(request.start, t + count)))
        run, stage, particle = (a[started, None] for a in (request.run, request.stage, request.particle))
        self._block_start = t
        self._block = self.noise.normals(run, stage, particle, np.arange(t, t + count))
        if self._chosen is not None and request.tape_law is not None:
            request.tape_law.transform(self._block, self._chosen, t)


def draw_lineage(
    noise: NoiseSource,
    law: TapeProposal | None,
    run: Integers,
    stage: NDArray[np.integer],
    particle: NDArray[np.integer],
) -> Floats:
    """Draw tapes (P, K, noise_size) again whose steps were drawn for several addresses, K at most all steps.

    Args:
        noise: Source of the noise.
        law: Law that they were drawn from.
        run: (P, 1) address.
        stage: (P, K) address of each step; a change begins a request of its own.
        particle: (P, K) address of each step.
    """
    tapes = noise.normals(run, stage, particle, np.arange(stage.shape[1]))
    if law is None:
        return tapes
    sums = np.zeros((len(tapes), law.terms))
    chosen: NDArray[Any] | None = None
    for t in range(stage.shape[1]):
        begun = np.flatnonzero(stage[:, t] != stage[:, t - 1]) if t else np.arange(len(tapes))
        if len(begun):
            uniform = noise.choices(run[begun, 0], stage[begun, t], particle[begun, t], CHOICES)
            fresh = law.choose(uniform, sums[begun] if t else None)
            chosen = np.zeros((len(tapes), *fresh.shape[1:]), fresh.dtype) if chosen is None else chosen
            chosen[begun] = fresh
        assert chosen is not None
        block = tapes[:, t : t + 1].copy()
        law.transform(block, chosen, t)
        tapes[:, t] = block[:, 0]
        terms, values = law.evidence(block[:, 0], t)
        sums[:, terms] += values.T
    return tapes
