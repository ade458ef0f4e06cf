"""Cells of the study: a reference problem, a setting, a number of runs, cut into blocks of one estimate."""

from __future__ import annotations

import os
import tempfile
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import avrare
from avrare.testing.problems import reference_problem, reference_problems

FAMILIES = ("walk", "ornstein_uhlenbeck", "count_down", "plus_minus", "reach", "response")
SETTINGS = ((100, 10), (250, 25), (250, 1), (250, 225))
COVERED = (
    "d_rw_L3.8", "d_rw_L4.8", "e_ou_L4.0", "f1_count_T40_q1o10_m12", "f2_pm1walk_T60_q2o5_m18",
    "g_eventually_c0.5",
)  # fmt: skip
COVERAGE_SETTINGS = ((500, 50), (1000, 100))
INTERVALS, RUNS_OF_INTERVAL = 1000, 10
SLOTS = 50_000
"""Particles of a block; with one discard a stage there are many stages, and larger blocks pay."""
SLOTS_OF_SINGLE = 250_000


@dataclass(frozen=True)
class Block:
    """Independent runs of one setting on one problem, made by one call of ``avrare.estimate``."""

    study: str
    problem: str
    particles: int
    discard: int
    number: int
    runs: int

    @property
    def cell(self) -> str:
        """Its cell's name."""
        return f"{self.study}-{self.problem}-N{self.particles}-K{self.discard}"

    @property
    def file(self) -> str:
        """Path of the outcome."""
        return f"{self.cell}-{self.number:03d}.npz"

    @property
    def seed(self) -> int:
        """Its own, so that cells are independent."""
        return 1000 * zlib.crc32(self.cell.encode()) + self.number

    def outcome(self) -> dict[str, Any]:
        """Run it."""
        problem = reference_problem(self.problem).problem(chunk=SLOTS_OF_SINGLE)
        result = avrare.estimate(
            problem, "ams", particles=self.particles, discard=self.discard, runs=self.runs, seed=self.seed,
            grow=False,
        )  # fmt: skip
        return {
            "values": result.run_probabilities,
            "steps": result.simulated_steps,
            "rollouts": result.rollouts,
            "relation": reference_problem(self.problem).relation,
        }


def blocks() -> Iterator[Block]:
    """Return all blocks of the studies of bias and coverage."""
    for reference in reference_problems():
        if reference.family in FAMILIES:
            for particles, discard in SETTINGS:
                yield from _cut("bias", reference.id, particles, discard, 1000)
    for name in COVERED:
        for particles, discard in COVERAGE_SETTINGS:
            yield from _cut("coverage", name, particles, discard, INTERVALS * RUNS_OF_INTERVAL)


def _cut(study: str, problem: str, particles: int, discard: int, runs: int) -> Iterator[Block]:
    slots = SLOTS_OF_SINGLE if discard == 1 else SLOTS
    size = max(slots // particles // RUNS_OF_INTERVAL, 1) * RUNS_OF_INTERVAL
    for number, first in enumerate(range(0, runs, size)):
        yield Block(study, problem, particles, discard, number, min(size, runs - first))


def run(task: tuple[Path, Any]) -> str:
    """Run a block and store its outcome, whole or not at all; a line about it."""
    folder, block = task
    began = time.process_time()
    outcome = block.outcome()
    handle, temporary = tempfile.mkstemp(dir=folder, prefix=".", suffix=".npz")
    os.close(handle)
    np.savez_compressed(temporary, **outcome)
    os.replace(temporary, folder / block.file)
    return f"{block.file}  {time.process_time() - began:.0f} CPU s"
