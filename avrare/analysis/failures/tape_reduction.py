"""Reduction of failing noise: to the numbers that the failure needs, and to the nearest one to the origin.

Delta debugging is ddmin (Zeller and Hildebrandt, "Simplifying and isolating failure-inducing input", 2002) on
noise: blocks of steps and channels are set to zero, from large blocks to single numbers, and the rest is
scaled down. All candidates of a round are evaluated at once; those that still fail are then combined, as many
as possible.

The design point of reliability analysis (FORM) is the point of the failure region nearest to the origin of
standard normal space, which is the most likely failure. From a known failure the search proceeds in rounds:
candidates turn the tape a little in random directions at a smaller norm, and a least-squares fit to all
recent rollouts gives the direction in which robustness falls fastest (the idea of Hasofer and Lind, and of
Rackwitz and Fiessler, with a sampled gradient). Before and after, delta debugging removes what is not needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from avrare.analysis.failures.tape_evaluator import TapeEvaluator
from avrare.protocols import Bools, Floats
from avrare.rollout.noise import NoiseSource

BlockOrder = Callable[[Floats], Floats]
"""Maps the norms (B,) of blocks to sort keys: least first."""
Block = tuple[slice, slice]


_FIRST_TURN, _MIN_TURN = 0.3, 0.01


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
    stop_ratio = 0.99  # another round follows if the last one brought the norm below this ratio
    while evaluate.remaining and np.linalg.norm(small) < stop_ratio * before:
        before = float(np.linalg.norm(small))
        for factor in (0.0, 0.5, 0.8, 0.95):
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
        factors = [float(factor) for factor in np.linspace(low, high, 24 + 2)[1:-1]]
        fails = evaluate(factor * tape for factor in factors).fails
        if len(fails) < len(factors) and not fails.any():  # the budget ended the search
            break
        least = next((k for k, failing in enumerate(fails) if failing), len(factors))
        low, high = [low, *factors, high][least : least + 2]
    return high * tape


def find_design_point(evaluate: TapeEvaluator, tape: Floats, seed: int) -> Floats:
    """Return a failing tape (steps + 1, noise_size) near the origin, starting from one that fails.

    The first reduction may use half of the budget; ``seed`` is that of the random directions.
    """
    evaluate.activity = "looking for the most likely failure"
    budget = evaluate.budget
    evaluate.budget -= evaluate.remaining // 2
    tape = reduce_tape(evaluate, tape)
    evaluate.budget = budget
    return descend(evaluate, tape, seed) if tape.any() else tape


def descend(evaluate: TapeEvaluator, tape: Floats, seed: int = 0, channels: Bools | None = None) -> Floats:
    """Return a failing tape nearer to the origin, without setting numbers to zero first.

    The tape (steps + 1, noise_size) fails and is not zero; only ``channels`` (noise_size,) change, if given.
    """
    nearer = _Descent(evaluate, tape, seed, channels).run()
    return reduce_tape(evaluate, nearer) if evaluate.remaining else nearer


class _Descent:
    """State of the search: ``norm * direction`` is the best failing tape, ``direction`` has length 1."""

    def __init__(self, evaluate: TapeEvaluator, tape: Floats, seed: int, channels: Bools | None) -> None:
        self.evaluate = evaluate
        self.noise = NoiseSource(seed, evaluate.shape[1])
        self.norm = float(np.linalg.norm(tape))
        self.direction = tape / self.norm
        self.channels = 1.0 if channels is None else channels
        self.turn = _FIRST_TURN
        self.tapes: Floats = np.zeros((0, *evaluate.shape))
        self.robustness: Floats = np.zeros(0)

    def run(self) -> Floats:
        """Search until nothing more is gained, or the budget or the rounds are used up."""
        lengths = (0.999, 0.99, 0.97, 0.94, 0.9, 0.8, 0.65, 0.5)
        for number in range(60):
            if not self.evaluate.remaining or self.turn < _MIN_TURN:
                break
            before = self.norm
            # 1. Turn in random directions at a slightly smaller norm.
            self._move([(lengths[1] * self.norm, turned) for turned in self._draw_directions(number)])
            # 2. Search along the estimated gradient.
            descent = self._estimate_descent()
            if descent is not None:
                ahead = [
                    _normalise((1.0 - w) * self.direction + w * descent) for w in (0.1, 0.25, 0.5, 0.75, 1.0)
                ]
                self._move([(length * self.norm, direction) for direction in ahead for length in lengths])
            # 3. Without progress, turn less.
            largest_ratio = 0.999  # smaller progress does not count
            if self.norm > largest_ratio * before:
                self.turn *= 0.5
        return self.norm * self.direction

    def _move(self, candidates: list[tuple[float, Floats]]) -> None:
        # to the nearest candidate (norm, direction) that fails
        tapes = [norm * direction for norm, direction in candidates[: self.evaluate.remaining]]
        if not tapes:
            return
        outcome = self.evaluate(tapes)
        finite = np.isfinite(outcome.robustness)
        most_tapes = 400  # number of the newest rollouts in the gradient estimate
        self.tapes = np.concatenate([self.tapes, np.stack(tapes)[finite]])[-most_tapes:]
        self.robustness = np.concatenate([self.robustness, outcome.robustness[finite]])[-most_tapes:]
        failing = [candidate for candidate, fails in zip(candidates, outcome.fails, strict=False) if fails]
        if failing:
            current = (self.norm, self.direction)
            self.norm, self.direction = min([current, *failing], key=lambda candidate: candidate[0])

    def _draw_directions(self, number: int) -> list[Floats]:
        # Half of the directions keep zeros at zero.
        steps = np.arange(self.evaluate.shape[0])
        count = 48
        random = self.noise.normals(0, number, np.arange(count)[:, None], steps)
        used = self.direction != 0.0
        random *= self.channels
        random[: count // 2] *= used if used.sum() > 1 else 1.0
        lengths = np.maximum(np.sqrt(np.einsum("nsc,nsc->n", random, random)), 1e-300)
        return [_normalise(self.direction + self.turn * z) for z in random / lengths[:, None, None]]

    def _estimate_descent(self) -> Floats | None:
        # Unit direction of steepest descent of robustness by ridge regression; None if flat.
        if len(self.tapes) < 8:
            return None
        moved = (self.tapes - self.norm * self.direction).reshape(len(self.tapes), -1)
        moved, value = moved - moved.mean(axis=0), self.robustness - self.robustness.mean()
        products = moved @ moved.T  # dual form: as large as the memory, however long a tape is
        ridge = 1e-4 * np.trace(products) / len(products) + 1e-300
        slope = moved.T @ np.linalg.solve(products + ridge * np.eye(len(products)), value)
        length = float(np.linalg.norm(slope))
        return -(slope / length).reshape(self.evaluate.shape) if length > 0.0 else None


def _normalise(direction: Floats) -> Floats:
    return np.asarray(direction / np.linalg.norm(direction))
