"""Setting to zero and scaling down what a failure does not need.

Delta debugging (Zeller and Hildebrandt, "Simplifying and isolating failure-inducing input", 2002) on noise:
blocks of steps and channels are set to zero, from large ones to single numbers, and the rest is scaled down.
All candidates of a round are driven at once; those that still fail are then joined, as many as will.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from avrare.failures.trials import Trials
from avrare.protocols import Floats

Order = Callable[[Floats, Floats], Floats]
"""From robustness (B,) without each of B blocks, and norms (B,) of the blocks: least where to begin."""

_LEAST_GAIN = 0.99
"""Another round is worth while where the last one brought the norm below this share."""
_FACTORS = (0.0, 0.5, 0.8, 0.95)
_SCALES = 24
Block = tuple[slice, slice]


def surest(robustness: Floats, norms: Floats) -> Floats:
    """First the blocks without which it fails most clearly."""
    return robustness


def mixed(seed: int) -> Order:
    """First the largest blocks, by and large; another ``seed`` mixes them otherwise, and 0 not at all."""
    random = np.random.default_rng(seed)

    def order(robustness: Floats, norms: Floats) -> Floats:
        return -norms * (random.uniform(0.3, 1.0, len(norms)) if seed else 1.0)

    return order


def reduce(trials: Trials, tape: Floats, order: Order = surest) -> Floats:
    """A smaller failing tape, from one that fails.

    Args:
        trials: Runs tapes and holds the budget.
        tape: (steps + 1, noise_size) that fails.
        order: Of blocks of the same size, of which not all can be left out together.
    """
    small, before = _scaled(trials, tape), math.inf
    sizes = list(_sizes(trials.shape))
    while trials.left and np.linalg.norm(small) < _LEAST_GAIN * before:
        before = float(np.linalg.norm(small))
        for factor in _FACTORS:
            for size in sizes if factor == 0.0 else sizes[-1:]:
                small = _reduced(trials, small, size, factor, order)
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


def _reduced(trials: Trials, tape: Floats, size: tuple[int, int], factor: float, order: Order) -> Floats:
    """As many blocks as possible multiplied by ``factor``."""
    blocks = _blocks(tape, size)
    if factor == 0.0 and len(blocks) == 1:
        return tape  # that would be the tape without noise, which passes
    while blocks:
        if 2 * len(blocks) > trials.left:
            return tape
        tried = trials(_times(tape, [block], factor) for block in blocks)
        norms = np.array([float(np.linalg.norm(tape[block])) for block in blocks])
        ranked = np.argsort(order(tried.robustness, norms), kind="stable")
        good = [blocks[k] for k in ranked if tried.fails[k]]
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
