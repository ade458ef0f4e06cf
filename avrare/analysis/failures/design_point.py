"""Design point search: the failing noise of the smallest norm, which is the most likely failure.

In reliability analysis (FORM) the design point is the point of the failure region nearest to the origin of
standard normal space. From a known failure the search proceeds in rounds: candidates turn the tape a little
in random directions at a smaller norm, and a least-squares fit to all recent rollouts gives the direction in
which robustness falls fastest (the idea of Hasofer and Lind, and of Rackwitz and Fiessler, with a sampled
gradient). Before and after, numbers that are not needed are set to zero.
"""

from __future__ import annotations

import numpy as np

from avrare.analysis.failures.delta_debugging import reduce_tape
from avrare.analysis.failures.tape_evaluator import TapeEvaluator
from avrare.protocols import Bools, Floats
from avrare.rollout.noise import NoiseSource

_DIRECTIONS = 48
_MAX_ROUNDS = 60
_FIRST_TURN, _MIN_TURN = 0.3, 0.01
_GRADIENT_SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
_LENGTHS = (0.999, 0.99, 0.97, 0.94, 0.9, 0.8, 0.65, 0.5)
_PROGRESS = 0.999
_MEMORY = 400
"""Number of the newest rollouts in the gradient estimate."""
_MIN_SAMPLES = 8
_RIDGE = 1e-4


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
    found = _Descent(evaluate, tape, seed, channels).run()
    return reduce_tape(evaluate, found) if evaluate.remaining else found


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
        for number in range(_MAX_ROUNDS):
            if not self.evaluate.remaining or self.turn < _MIN_TURN:
                break
            before = self.norm
            # 1. Turn in random directions at a slightly smaller norm.
            self._move([(_LENGTHS[1] * self.norm, turned) for turned in self._draw_directions(number)])
            # 2. Search along the estimated gradient.
            descent = self._estimate_descent()
            if descent is not None:
                ahead = [_normalise((1.0 - w) * self.direction + w * descent) for w in _GRADIENT_SHARES]
                self._move([(length * self.norm, one) for one in ahead for length in _LENGTHS])
            # 3. Without progress, turn less.
            if self.norm > _PROGRESS * before:
                self.turn *= 0.5
        return self.norm * self.direction

    def _move(self, candidates: list[tuple[float, Floats]]) -> None:
        # to the nearest candidate (norm, direction) that fails
        tapes = [norm * direction for norm, direction in candidates[: self.evaluate.remaining]]
        if not tapes:
            return
        outcome = self.evaluate(tapes)
        finite = np.isfinite(outcome.robustness)
        self.tapes = np.concatenate([self.tapes, np.stack(tapes)[finite]])[-_MEMORY:]
        self.robustness = np.concatenate([self.robustness, outcome.robustness[finite]])[-_MEMORY:]
        failing = [one for one, fails in zip(candidates, outcome.fails, strict=False) if fails]
        if failing:
            current = (self.norm, self.direction)
            self.norm, self.direction = min([current, *failing], key=lambda one: one[0])

    def _draw_directions(self, number: int) -> list[Floats]:
        # Half of the directions keep zeros at zero.
        steps = np.arange(self.evaluate.shape[0])
        random = self.noise.normals(0, number, np.arange(_DIRECTIONS)[:, None], steps)
        used = self.direction != 0.0
        random *= self.channels
        random[: _DIRECTIONS // 2] *= used if used.sum() > 1 else 1.0
        lengths = np.maximum(np.sqrt(np.einsum("nsc,nsc->n", random, random)), 1e-300)
        return [_normalise(self.direction + self.turn * z) for z in random / lengths[:, None, None]]

    def _estimate_descent(self) -> Floats | None:
        # Unit direction of steepest descent of robustness by ridge regression; None if flat.
        if len(self.tapes) < _MIN_SAMPLES:
            return None
        moved = (self.tapes - self.norm * self.direction).reshape(len(self.tapes), -1)
        moved, value = moved - moved.mean(axis=0), self.robustness - self.robustness.mean()
        products = moved @ moved.T  # dual form: as large as the memory, however long a tape is
        ridge = _RIDGE * np.trace(products) / len(products) + 1e-300
        slope = moved.T @ np.linalg.solve(products + ridge * np.eye(len(products)), value)
        length = float(np.linalg.norm(slope))
        return -(slope / length).reshape(self.evaluate.shape) if length > 0.0 else None


def _normalise(direction: Floats) -> Floats:
    return np.asarray(direction / np.linalg.norm(direction))
