"""The most likely failure: the failing noise of the smallest norm, which has the largest density.

From a failure the search goes down in rounds. Each turns the tape a little in many random directions at a
smaller norm. Those that fail are steps by themselves, and all of them together tell by least squares where
robustness falls fastest: the next tapes lie that way, nearer to the origin (the idea of Hasofer and Lind,
and of Rackwitz and Fiessler, with a sampled gradient). In between, numbers that are not needed go to zero.
"""

from __future__ import annotations

import numpy as np

from avrare.failures.reduce import reduce
from avrare.failures.trials import Trials
from avrare.protocols import Bools, Floats
from avrare.rollout.noise import NoiseSource

_DIRECTIONS = 48
_ROUNDS = 60
_FIRST_TURN, _LEAST_TURN = 0.3, 0.01
_TOWARDS = (0.1, 0.25, 0.5, 0.75, 1.0)
"""Shares of the estimated direction in the next one."""
_LENGTHS = (0.999, 0.99, 0.97, 0.94, 0.9, 0.8, 0.65, 0.5)
_BETTER = 0.999
_MEMORY = 400
"""So many of the newest rollouts tell the slope."""
_LEAST_SAMPLES = 8
_RIDGE = 1e-4


def nearest(trials: Trials, tape: Floats, seed: int) -> Floats:
    """A failing tape near the origin, from one that fails.

    Args:
        trials: Runs tapes and holds the budget, half of which zeroing may take at first.
        tape: (steps + 1, noise_size) that fails.
        seed: Of the random directions.
    """
    trials.doing = "looking for the most likely failure"
    budget = trials.budget
    trials.budget -= trials.left // 2
    tape = reduce(trials, tape)
    trials.budget = budget
    if not tape.any():
        return tape
    return descend(trials, tape, seed)


def descend(trials: Trials, tape: Floats, seed: int = 0, within: Bools | None = None) -> Floats:
    """A failing tape nearer to the origin, from one that fails, without zeroing first.

    Args:
        trials: Runs tapes and holds the budget.
        tape: (steps + 1, noise_size) that fails, and is not zero.
        seed: Of the random directions.
        within: (noise_size,) channels that may change; None: all.
    """
    found = _Descent(trials, tape, seed, within).run()
    return reduce(trials, found) if trials.left else found


class _Descent:
    """Where the search is, how far it turns, and the newest rollouts around.

    ``direction`` has length 1; the tape there times ``norm`` fails.
    """

    def __init__(self, trials: Trials, tape: Floats, seed: int, within: Bools | None) -> None:
        self.trials = trials
        self.noise = NoiseSource(seed, trials.shape[1])
        self.norm = float(np.linalg.norm(tape))
        self.direction = tape / self.norm
        self.within = 1.0 if within is None else within
        self.turn = _FIRST_TURN
        self.tapes: Floats = np.zeros((0, *trials.shape))
        self.robustness: Floats = np.zeros(0)

    def run(self) -> Floats:
        """The tape where nothing more is gained, or the budget or the rounds are spent."""
        for number in range(_ROUNDS):
            if not self.trials.left or self.turn < _LEAST_TURN:
                break
            before = self.norm
            self._try([(_LENGTHS[1] * self.norm, direction) for direction in self._around(number)])
            downhill = self._downhill()
            if downhill is not None:
                ahead = [_unit((1.0 - share) * self.direction + share * downhill) for share in _TOWARDS]
                self._try([(length * self.norm, direction) for direction in ahead for length in _LENGTHS])
            if self.norm > _BETTER * before:
                self.turn *= 0.5
        return self.norm * self.direction

    def _try(self, steps: list[tuple[float, Floats]]) -> None:
        """Go to the nearest of the places (norm, direction) that fail, if it is nearer; remember all."""
        tapes = [norm * direction for norm, direction in steps[: self.trials.left]]
        if not tapes:
            return
        tried = self.trials(tapes)
        whole = np.isfinite(tried.robustness)
        self.tapes = np.concatenate([self.tapes, np.stack(tapes)[whole]])[-_MEMORY:]
        self.robustness = np.concatenate([self.robustness, tried.robustness[whole]])[-_MEMORY:]
        failing = [step for step, fails in zip(steps, tried.fails, strict=False) if fails]
        if failing:
            here = (self.norm, self.direction)
            self.norm, self.direction = min([here, *failing], key=lambda step: step[0])

    def _around(self, number: int) -> list[Floats]:
        """Random unit directions around the present one: half of them turn only the numbers in use."""
        steps = np.arange(self.trials.shape[0])
        random = self.noise.normals(0, number, np.arange(_DIRECTIONS)[:, None], steps)
        used = self.direction != 0.0
        random *= self.within
        random[: _DIRECTIONS // 2] *= used if used.sum() > 1 else 1.0
        lengths = np.maximum(np.sqrt(np.einsum("nsc,nsc->n", random, random)), 1e-300)
        return [_unit(self.direction + self.turn * z) for z in random / lengths[:, None, None]]

    def _downhill(self) -> Floats | None:
        """Unit direction in which robustness falls, as the rollouts tell; None where it is flat."""
        if len(self.tapes) < _LEAST_SAMPLES:
            return None
        moved = (self.tapes - self.norm * self.direction).reshape(len(self.tapes), -1)
        moved, value = moved - moved.mean(axis=0), self.robustness - self.robustness.mean()
        products = moved @ moved.T  # as large as the memory, however long a tape is
        ridge = _RIDGE * np.trace(products) / len(products) + 1e-300
        slope = moved.T @ np.linalg.solve(products + ridge * np.eye(len(products)), value)
        length = float(np.linalg.norm(slope))
        return -(slope / length).reshape(self.trials.shape) if length > 0.0 else None


def _unit(direction: Floats) -> Floats:
    return np.asarray(direction / np.linalg.norm(direction))
