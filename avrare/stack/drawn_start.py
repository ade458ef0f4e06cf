"""Starts whose options are drawn from the noise tape, and the treatment of impossible ones.

The first numbers of row 0 of a tape are the normal scores of the drawn options: correlated by a Gaussian
copula, then each mapped by the inverse distribution function of its law. A scene that is impossible is drawn
again from a generator that is keyed by the bits of those numbers, so the tape still decides the rollout.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.driving.geometry import ego_rectangle, other_rectangles, signed_distance
from avrare.driving.values import Scene, World
from avrare.protocols import Bools, Floats, Signals, Simulator, Specification
from avrare.scenario.draws import Draws

SIGNAL = "drawn_"
"""Beginning of the name of the signal of a drawn option: ``drawn_ego_speed``."""


@dataclass(frozen=True)
class DrawnValues:
    """Values drawn for N particles.

    Attributes:
        values: (N, K) values of the options.
        redraws: (N,) how often the scene was drawn again.
        refused: (N,) True where the scene is impossible for good: an error.
    """

    values: Floats
    redraws: NDArray[np.int64]
    refused: Bools


class DrawnStart:
    """Start of a simulator whose options are drawn.

    Args:
        draws: Options, laws and settings.
        simulator: Result of ``Simulator.drawing``.
        specifications: Monitors of the scenario, by name: a start must violate none.

    Attributes:
        size: K, the number of drawn options.
        noise_names: Name of each number.
        signal_names: Name of each value as a signal.
    """

    def __init__(
        self, draws: Draws, simulator: Simulator, specifications: Mapping[str, Specification]
    ) -> None:
        self.draws, self.size = draws, len(draws.laws)
        self.noise_names = tuple(f"draw of {name}" for name in draws.names)
        self.signal_names = tuple(SIGNAL + re.sub(r"\W", "_", name) for name in draws.names)
        self._factor = _square_root(draws.correlation)
        self._simulator, self._scene = simulator, simulator.scene
        self._specifications = specifications

    def reset(self, noise: Floats) -> tuple[World, DrawnValues]:
        """Return the worlds at t = 0 and the drawn values, from noise (N, K + the simulator's)."""
        scores, rest = noise[:, : self.size], noise[:, self.size :]
        values, world = self._place(scores, rest)
        again, refused = self._judge(world, values)
        redraws = np.zeros(len(noise), dtype=np.int64)
        generators = {row: _generator(scores[row]) for row in np.flatnonzero(again).tolist()}
        for _ in range(self.draws.settings.attempts - 1):
            rows = np.flatnonzero(again)
            if not rows.size:
                break
            fresh = np.stack([generators[row].standard_normal(self.size) for row in rows.tolist()])
            redraws[rows] += 1
            values[rows], placed = self._place(fresh, rest[rows])
            world = batch.map_leaves(lambda old, new, at=rows: _put(old, at, new), world, placed)
            again[rows], refused[rows] = self._judge(placed, values[rows])
        return world, DrawnValues(values, redraws, refused | again)

    def signals(self, drawn: DrawnValues) -> dict[str, Floats]:
        """Return the drawn values as signals (N,)."""
        return {name: drawn.values[:, k] for k, name in enumerate(self.signal_names)}

    def _place(self, scores: Floats, rest: Floats) -> tuple[Floats, World]:
        # Sums of products in one order: the bits of a row may not depend on the size of the batch.
        correlated = [
            sum((self._factor[k, j] * scores[:, j] for j in range(k)), self._factor[k, k] * scores[:, k])
            for k in range(self.size)
        ]
        values = np.stack([law.at(z) for law, z in zip(self.draws.laws, correlated, strict=True)], axis=1)
        named = {path: values[:, k] for k, path in enumerate(self.draws.paths)}
        return values, self._simulator.reset_drawn(rest, named)

    def _judge(self, world: World, values: Floats) -> tuple[Bools, Bools]:
        # Rows to draw again, and rows that are errors.
        settings, none = self.draws.settings, np.zeros(len(values), dtype=bool)
        overlapping = none if self._scene is None else _overlaps(world, self._scene)
        broken = none
        if settings.broken_rule != "keep":
            drawn = DrawnValues(values, np.zeros(len(values), dtype=np.int64), none)
            broken = self._find_broken({**self._simulator.signals(world), **self.signals(drawn)})
        impossible = self._simulator.impossible(world)
        again, refused = none.copy() if impossible is None else impossible.copy(), none.copy()
        for rows, rule in ((overlapping, settings.overlap), (broken, settings.broken_rule)):
            again |= rows & (rule == "resample")
            refused |= rows & (rule == "error")
        return again, refused

    def _find_broken(self, signals: Signals) -> Bools:
        n = len(next(iter(signals.values())))
        broken = np.zeros(n, dtype=bool)
        for monitor in self._specifications.values():
            state, verdict = monitor.update(monitor.start(n), signals)
            if monitor.margin(state) is not None:
                broken |= verdict.violated
        return broken


def _overlaps(world: World, scene: Scene) -> Bools:
    others = other_rectangles(world.others, scene)
    distance = signed_distance(ego_rectangle(world.ego, scene), others)
    overlapping = np.asarray((distance <= 0.0).any(axis=1))
    for k in range(1, others.x.shape[1]):
        vehicle, earlier = (
            type(others)(*(np.broadcast_to(part, others.x.shape)[:, rows] for part in vars(others).values()))
            for rows in (slice(k, k + 1), slice(0, k))
        )
        overlapping |= (signed_distance(vehicle, earlier) <= 0.0).any(axis=1)
    return overlapping


def _put(old: NDArray[np.generic], rows: NDArray[np.int64], new: NDArray[np.generic]) -> NDArray[np.generic]:
    leaf = old.copy()
    leaf[rows] = new
    return leaf


def _generator(scores: Floats) -> np.random.Generator:
    bits = np.ascontiguousarray(scores, dtype=np.float64).view(np.uint32)
    return np.random.default_rng([1, *bits.tolist()])


def _square_root(matrix: Floats) -> Floats:
    """Return the lower triangle L with L L^T = ``matrix``, which may be singular (Cholesky)."""
    factor = np.zeros_like(matrix)
    for j in range(len(matrix)):
        left = matrix[j:, j] - factor[j:, :j] @ factor[j, :j]
        if left[0] > 1e-12:
            factor[j:, j] = left / np.sqrt(left[0])
    return factor
