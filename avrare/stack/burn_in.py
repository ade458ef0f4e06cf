"""Burn-in: perception and tracker run for a while before t = 0, so that tracks come from detections.

The worlds before t = 0 are the start, rewound: everybody has come at the speed and with the heading that they
start with, so the scene at t = 0 is that of the scenario. Nothing that happens then counts.

The noise of the burn-in belongs to row 0 of the tape. Each number of perception there is the key of a
generator that gives the channel's numbers of the burn-in, so that the tape still decides the rollout, and a
channel its own errors. The values of a perfect perception, and 0, last for the whole burn-in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from avrare.base.philox import philox, to_uniform
from avrare.driving import Observation, Vehicles
from avrare.protocols import Floats, PerceptionErrorModel, Tracker
from avrare.stack.observation import observe
from avrare.stack.part_checks import find_perfect_noise

_TAG = np.uint64(0x6275726E)
"""Word of the counter that keeps these numbers apart from others of the same key."""


class BurnIn:
    """Burn-in of a tracker.

    Args:
        tracker: The tracker.
        perception: Perception that it uses; None: it sees the truth.
        steps: Number of observations, the last of them at t = 0.
        dt: Step [s].
    """

    def __init__(
        self, tracker: Tracker, perception: PerceptionErrorModel | None, steps: int, dt: float
    ) -> None:
        self._tracker, self._perception, self._steps, self._dt = tracker, perception, steps, dt
        self._perfect = find_perfect_noise(perception) if perception is not None else np.zeros(0)

    def run(self, world: object, noise: Floats) -> tuple[Observation | None, object, object]:
        """Return observation, track and memory of perception at t = 0, from noise (N, P) of perception."""
        track, observation = self._tracker.start(world), None
        noise = noise[:, : len(self._perfect)]  # a proposal may need more
        latent = self._perception.start(noise) if self._perception is not None else None
        for before, numbers in self.worlds(world, noise):
            observation, latent = observe(self._perception, before, numbers, latent)
            track = self._tracker.update(track, observation)
        return observation, track, latent

    def worlds(self, world: Any, noise: Floats) -> Iterator[tuple[Any, Floats]]:
        """Yield the worlds up to t = 0 and the noise (N, P) of the observation of each."""
        for step in range(self._steps - 1, -1, -1):
            time = step * self._dt
            ego, others = (rewind(vehicles, time) for vehicles in (world.ego, world.others))
            yield replace(world, ego=ego, others=others), self._noise(noise, step)

    def _noise(self, first: Floats, step: int) -> Floats:
        """Return standard normals (N, P) of a step before t = 0, from the numbers of row 0."""
        bits = np.ascontiguousarray(first).view(np.uint64)
        key = bits & np.uint64(0xFFFFFFFF), bits >> np.uint64(32)
        counter = np.uint64(step), np.arange(first.shape[1], dtype=np.uint64), _TAG, np.uint64(0)
        words = philox(tuple(np.broadcast_to(word, first.shape) for word in counter), key)  # type: ignore[arg-type]
        radius = np.sqrt(-2.0 * np.log(to_uniform(words[0], words[1])))
        drawn = radius * np.cos(2.0 * np.pi * to_uniform(words[2], words[3]))
        return np.where((first == 0.0) | (first == self._perfect), first, drawn)


def rewind(vehicles: Vehicles, time: float) -> Vehicles:
    """Return where vehicles were this time ago [s], at the speed and heading that they have."""
    way = vehicles.speed * time
    return replace(
        vehicles,
        x=vehicles.x - way * np.cos(vehicles.heading),
        y=vehicles.y - way * np.sin(vehicles.heading),
        acceleration=np.zeros_like(vehicles.acceleration),
    )
