"""Delta debugging: sets to zero and scales down the noise that a failure does not need.

The algorithm is ddmin (Zeller and Hildebrandt, "Simplifying and isolating failure-inducing input", 2002) on
noise: blocks of steps and channels are set to zero, from large blocks to single numbers, and the rest is
scaled down. All candidates of a round are evaluated at once; those that still fail are then combined, as many
as possible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from avrare.analysis.failures.tape_evaluator import TapeEvaluator
from avrare.protocols import Floats

BlockOrder = Callable[[Floats], Floats]
"""Maps the norms (B,) of blocks to sort keys: least first."""
Block = tuple[slice, slice]

_STOP_RATIO = 0.99
"""Another round follows if the last one brought the norm below this ratio."""
_FACTORS = (0.0, 0.5, 0.8, 0.95)
_SCALES = 24


def order_by_norm(seed: int) -> BlockOrder:
    """Return an order that puts large blocks first, randomly perturbed unless ``seed`` is 0."""
    random = np.random.default_rng(seed)
    return lambda norms: -norms * (random.uniform(0.3, 1.0, len(norms)) if seed else 1.0)


def reduce_tape(evaluate: TapeEvaluator, tape: Floats, order: BlockOrder | None = None) -> Floats:
    """Return a smaller failing tape (steps + 1, noise_size), starting from one that fails.

    If not all blocks of a size can be removed, ``order`` says which come first; by default these are those
    without which the rollout fails most clearly.
    """
    small, before = _scale_down(evaluate, tape), math.inf
    sizes = list(_list_block_sizes(evaluate.shape))
    while evaluate.remaining and np.linalg.norm(small) < _STOP_RATIO * before:
        before = float(np.linalg.norm(small))
        for factor in _FACTORS:
            for size in sizes if factor == 0.0 else sizes[-1:]:
                small = _reduce_blocks(evaluate, small, size, factor, order)
        small, sizes = _scale_down(evaluate, small), sizes[-1:]
    return small


def _list_block_sizes(shape: tuple[int, int]) -> Iterator[tuple[int, int]]:
    # All steps of ever fewer channels, then ever fewer steps, finally single numbers.
    steps, channels = shape
    for size in _list_halvings(channels):
        yield steps, size
        yield max(steps // 4, 1), size
    for size in _list_halvings(steps)[2:]:
        yield size, channels
    for size in _list_halvings(steps)[3:]:
        yield size, 1


def _list_halvings(size: int) -> list[int]:
    return [math.ceil(size / 2**k) for k in range(max(size - 1, 0).bit_length() + 1)]


def _find_nonzero_blocks(tape: Floats, size: tuple[int, int]) -> list[Block]:
    steps, channels = tape.shape
    corners = [(t, c) for t in range(0, steps, size[0]) for c in range(0, channels, size[1])]
    blocks = [(slice(t, t + size[0]), slice(c, c + size[1])) for t, c in corners]
    return [block for block in blocks if tape[block].any()]


def _reduce_blocks(
    evaluate: TapeEvaluator, tape: Floats, size: tuple[int, int], factor: float, order: BlockOrder | None
) -> Floats:
    blocks = _find_nonzero_blocks(tape, size)
    if factor == 0.0 and len(blocks) == 1:
        return tape  # without its only block the tape is zero, which passes
    while blocks:
        if 2 * len(blocks) > evaluate.remaining:
            return tape
        # 1. Try each block by itself.
        single = evaluate(_multiply(tape, [block], factor) for block in blocks)
        keys = single.robustness
        if order is not None:
            keys = order(np.array([float(np.linalg.norm(tape[block])) for block in blocks]))
        ranked = np.argsort(keys, kind="stable")
        removable = [blocks[k] for k in ranked if single.fails[k]]
        if not removable:
            return tape
        # 2. Combine the first n of the removable blocks, for the largest n that still fails.
        counts = _list_descending_counts(len(removable))
        combined = evaluate(_multiply(tape, removable[:count], factor) for count in counts)
        count = next((n for n, fails in zip(counts, combined.fails, strict=False) if fails), 1)
        # 3. Continue with the removable blocks that are left.
        tape = _multiply(tape, removable[:count], factor)
        blocks = removable[count:]
    return tape


def _list_descending_counts(largest: int) -> list[int]:
    counts = {math.ceil(largest * 0.8**k) for k in range(24)} | {largest - 1}
    return sorted((count for count in counts if count > 1), reverse=True)  # one fails by itself


def _multiply(tape: Floats, blocks: list[Block], factor: float) -> Floats:
    changed = tape.copy()
    for block in blocks:
        changed[block] = factor * changed[block] + 0.0  # no negative zeros
    return changed


def _scale_down(evaluate: TapeEvaluator, tape: Floats) -> Floats:
    low, high = 0.0, 1.0
    while evaluate.remaining and high - low > 1e-3:
        factors = [float(factor) for factor in np.linspace(low, high, _SCALES + 2)[1:-1]]
        fails = evaluate(factor * tape for factor in factors).fails
        if len(fails) < len(factors) and not fails.any():  # the budget ended the search
            break
        least = next((k for k, failing in enumerate(fails) if failing), len(factors))
        low, high = [low, *factors, high][least : least + 2]
    return high * tape
