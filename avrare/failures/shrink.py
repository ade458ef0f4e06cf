"""The smallest disturbance that still fails.

Delta debugging (Zeller and Hildebrandt, "Simplifying and isolating failure-inducing input", 2002) on noise:
blocks of steps and channels are set to zero, from large ones to single numbers, and the rest is scaled down.
All candidates of a round are driven at once; those that still fail are then joined, as many as will.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from avrare.errors import UsageError
from avrare.failures.trials import Progress, Trials
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem

BUDGET = 3000
"""Rollouts of one shrinking, unless told otherwise."""
ENOUGH = 0.1
"""Share of the norm that should be left at most."""

_LEAST_GAIN = 0.99
"""Another round is worth while where the last one brought the norm below this share."""
_FACTORS = (0.0, 0.5, 0.8, 0.95)
_SCALES = 24
_TRIES = 25
Block = tuple[slice, slice]


@dataclass(frozen=True)
class Shrunk:
    """A failure and what is left of it.

    Attributes:
        noise: (steps + 1, noise_size) of the shrunk failure.
        before: Norm of the noise at the start.
        after: Norm of what is left.
        numbers: Entries of the noise that are not zero.
        rollouts: That it took.
        reason: Why more than a tenth of the norm is left, or None where it is not.
        rescue: (steps + 1, noise_size) where the rollout without noise fails, so that nothing is left: small
            noise with which it passes, as what is missing without. Else, or where none was found, None.
    """

    noise: Floats
    before: float
    after: float
    numbers: int
    rollouts: int
    reason: str | None
    rescue: Floats | None = None

    @property
    def ratio(self) -> float:
        """Norm after over norm before."""
        return self.after / self.before if self.before > 0.0 else 0.0


def shrink(problem: Problem, tape: Floats, budget: int = BUDGET, progress: Progress | None = None) -> Shrunk:
    """Make the noise of a failure as small as it goes, while it fails.

    Args:
        problem: Whose first specification is violated.
        tape: (steps + 1, noise_size) of the failure.
        budget: Rollouts at most.
        progress: Is told how it goes.

    Raises:
        UsageError: The tape does not fail.
    """
    trials = Trials(problem, budget, progress)
    trials.doing = "shrinking"
    first = trials([tape, np.zeros_like(tape)])
    if not first.fails[:1].any():
        raise UsageError("the rollout does not fail: there is nothing to shrink")
    if first.fails[1:].any():
        rescue = _rescue(problem, trials)
        return Shrunk(np.zeros_like(tape), float(np.linalg.norm(tape)), 0.0, 0, trials.rollouts, None, rescue)
    small = reduce(trials, tape)
    before, after = float(np.linalg.norm(tape)), float(np.linalg.norm(small))
    reason = _reason(trials, before, after)
    return Shrunk(small, before, after, int(np.count_nonzero(small)), trials.rollouts, reason)


def _reason(trials: Trials, before: float, after: float) -> str | None:
    if after <= ENOUGH * before:
        return None
    if trials.short or not trials.left:
        return "the budget of rollouts is spent"
    return f"a tenth is a norm of {ENOUGH * before:.2g}, and nothing below {after:.2g} that was tried fails"


def _rescue(problem: Problem, trials: Trials) -> Floats | None:
    """A small tape that passes, from the first random one that does."""
    passing = Trials(problem, trials.left, trials.progress, passing=True)
    passing.doing = "looking for what passes"
    noise = NoiseSource(0, problem.noise_size)
    steps = np.arange(problem.steps + 1)
    tapes = [noise.normals(0, 0, particle, steps) for particle in range(_TRIES)]
    passes = np.flatnonzero(passing(tapes).fails)
    small = reduce(passing, tapes[int(passes[0])]) if len(passes) else None
    trials.rollouts += passing.rollouts
    return small


def reduce(trials: Trials, tape: Floats) -> Floats:
    """A smaller failing tape, from one that fails."""
    small, before = _scaled(trials, tape), math.inf
    sizes = list(_sizes(trials.shape))
    while trials.left and np.linalg.norm(small) < _LEAST_GAIN * before:
        before = float(np.linalg.norm(small))
        for factor in _FACTORS:
            for size in sizes if factor == 0.0 else sizes[-1:]:
                small = _reduced(trials, small, size, factor)
        small, sizes = _scaled(trials, small), sizes[-1:]
    return small


def _sizes(shape: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Sizes of blocks: all steps of ever fewer channels, then ever fewer steps, last single numbers."""
    steps, channels = shape
    for size in _halves(channels):
        yield steps, size
        yield max(steps // 4, 1), size
    for size in _halves(steps)[2:]:
        yield size, channels
    for size in _halves(steps)[3:]:
        yield size, 1


def _halves(size: int) -> list[int]:
    """``size``, half of it, ... 1."""
    return [math.ceil(size / 2**k) for k in range(max(size - 1, 0).bit_length() + 1)]


def _blocks(tape: Floats, size: tuple[int, int]) -> list[Block]:
    """The blocks of a size with anything in them."""
    steps, channels = tape.shape
    corners = [(t, c) for t in range(0, steps, size[0]) for c in range(0, channels, size[1])]
    blocks = [(slice(t, t + size[0]), slice(c, c + size[1])) for t, c in corners]
    return [block for block in blocks if tape[block].any()]


def _reduced(trials: Trials, tape: Floats, size: tuple[int, int], factor: float) -> Floats:
    """As many blocks as possible multiplied by ``factor``."""
    blocks = _blocks(tape, size)
    if factor == 0.0 and len(blocks) == 1:
        return tape  # that would be the tape without noise, which passes
    while blocks:
        if 2 * len(blocks) > trials.left:
            trials.short = True
            return tape
        tried = trials(_times(tape, [block], factor) for block in blocks)
        order = np.argsort(tried.robustness, kind="stable")
        good = [blocks[k] for k in order if tried.fails[k]]
        if not good:
            return tape
        counts = _counts(len(good))
        joined = trials(_times(tape, good[:count], factor) for count in counts)
        many = next((n for n, fails in zip(counts, joined.fails, strict=False) if fails), 1)
        tape = _times(tape, good[:many], factor)
        blocks = good[many:]
    return tape


def _counts(most: int) -> list[int]:
    """How many blocks are joined: from all of them down to two; one alone is known to fail."""
    shares = {math.ceil(most * 0.8**k) for k in range(24)} | {most - 1}
    return sorted((count for count in shares if count > 1), reverse=True)


def _times(tape: Floats, blocks: list[Block], factor: float) -> Floats:
    changed = tape.copy()
    for block in blocks:
        changed[block] = factor * changed[block] + 0.0  # no negative zeros
    return changed


def _scaled(trials: Trials, tape: Floats) -> Floats:
    """The tape times the least factor that fails, to a thousandth."""
    low, high = 0.0, 1.0
    while trials.left and high - low > 1e-3:
        factors = [float(factor) for factor in np.linspace(low, high, _SCALES + 2)[1:-1]]
        fails = trials(factor * tape for factor in factors).fails
        if len(fails) < len(factors) and not fails.any():  # the budget has ended the search
            break
        least = next((k for k, failing in enumerate(fails) if failing), len(factors))
        low, high = [low, *factors, high][least : least + 2]
    return high * tape
