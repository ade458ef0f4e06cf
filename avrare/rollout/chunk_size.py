"""Size of a chunk, where none is named: results do not depend on it, only time and memory do."""

from __future__ import annotations

import math

import numpy as np

from avrare.base import batch
from avrare.protocols import Specification, System

LEAST, MOST = 25, 4096
WORLD_ROWS = 50
"""Rows of worlds that are simulated one at a time: a policy that acts on them all at once pays for fewer."""


def choose_chunk(system: System, monitors: tuple[Specification, ...], steps: int) -> int:
    """Return the largest number of rows per chunk, from the memory of one row and the steps of a rollout."""
    if system.lacks is not None:
        return WORLD_ROWS
    most_bytes = 2**22  # fewer rows cost more overhead than a cache saves
    most_steps = 2**17  # so that progress is seen and saved now and then
    rows = min(most_bytes // max(_bytes_of_a_row(system, monitors), 1), most_steps // max(steps, 1))
    return int(np.clip(rows, LEAST, MOST))


def spread(rows: int, chunk: int, workers: int) -> int:
    """Return the size of pieces, at most ``chunk``, that give all workers equally much."""
    rounds = math.ceil(rows / (chunk * workers))
    return math.ceil(rows / max(rounds * workers, 1))


def _bytes_of_a_row(system: System, monitors: tuple[Specification, ...]) -> int:
    try:
        state = system.initial(np.zeros((1, system.noise_size)))
        signals = system.signals(state)
        started = tuple(monitor.update(monitor.start(1), signals)[0] for monitor in monitors)
        return sum(leaf.nbytes for leaf in batch.leaves((state, started)))
    except (Exception, SystemExit):  # whatever is wrong is told, or counted, where the rollouts run
        return 0
