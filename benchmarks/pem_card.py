"""The figures of docs/perception.md, from the shipped models themselves.

    avrare pem convert nuscenes_inputs.txt nuscenes_labels.txt --period 0.5 --out data
    OMP_NUM_THREADS=1 python benchmarks/pem_card.py data.csv

Prints each model's scores on the held-out fifth, its counts of large errors, misses and misses after a miss
beside those of the data, what it says of a car straight ahead in full view, and how long 250 worlds of 3
vehicles take. Needs the training extra of avrare-pem-training (scipy), but trains nothing.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from avrare.base.batch import take
from avrare.driving import Road, Scene, Vehicles, World
from avrare_gp_pem.config import GpPemConfig
from avrare_gp_pem.runtime.features import Box, box_of, features
from avrare_gp_pem.runtime.models import build_gp
from avrare_gp_pem.runtime.observation_model import NOISE_PER_VEHICLE
from avrare_gp_pem.runtime.store import load, locate
from avrare_gp_pem.runtime.visibility import relative, visibility
from avrare_pem_training.cleaning import CleanedData, clean
from avrare_pem_training.counts import count_events, misses_after_misses
from avrare_pem_training.persistence import describe_persistence
from avrare_pem_training.report import summary
from avrare_pem_training.scores import evaluate
from avrare_pem_training.table import read_table

MODELS = ("measured", "best", "paper", "literal", "pointpillars")
RANGES = (5.0, 10.0, 20.0, 30.0, 40.0, 45.0, 50.0, 55.0, 60.0)
SAMPLES = 100_000
WORLDS, VEHICLES, REPEATS = 250, 3, 1000


def held_out(model: str, data: CleanedData) -> None:
    """Print scores on the rows that training leaves out."""
    for line in summary({name: one.scores for name, one in evaluate(load(locate(model)), data).items()}):
        print(line)


def counts(model: str, data: CleanedData) -> None:
    """Print large errors and misses by range, in training and held-out rows, and misses after misses."""
    fitted = load(locate(model))
    parts = [data.train.take(data.oblique), data.test.take(data.test_oblique)]
    for pair in zip(*(count_events(fitted, rows) for rows in parts), strict=True):
        cells = "; ".join(f"{one.rows} rows, {one.seen} seen, {one.own:.1f} expected" for one in pair)
        print(f"{pair[0].what}: {cells}")
    for name, rows in zip(("training", "held out"), parts, strict=True):
        for one in misses_after_misses(fitted, rows):
            print(
                f"{name}, {one.seconds:g} s after a miss, {one.pairs} pairs: missed {one.seen:.3f}, "
                f"drawn anew {one.anew:.3f}, with persistence {one.lasting:.3f}"
            )
    print(describe_persistence(fitted.persistence))


def straight_ahead(model: str) -> None:
    """Print detection and errors of an aligned car at several ranges."""
    pem = build_gp(GpPemConfig(model=model), _scene(1))
    print("range [m]   P(detect)   sd along [m]   sd across [m]   mean along [m]")
    for distance in RANGES:
        world = _worlds(np.full((SAMPLES, 1), distance), np.zeros((SAMPLES, 1)))
        law = pem.law(take(world, slice(0, 1)))
        noise = np.random.default_rng(0).normal(size=(SAMPLES, NOISE_PER_VEHICLE))
        noise[:, 0] = -9.0  # always seen: errors of the seen ones
        seen = pem.observe(world, noise)
        along, across = distance - seen.x[:, 0], -seen.y[:, 0]
        print(
            f"{distance:9.0f} {float(law.detect[0, 0]):11.3f} {np.nanstd(along):14.2f}"
            f" {np.nanstd(across):15.2f} {np.nanmean(along):16.2f}"
        )


def timing(model: str) -> None:
    """Print the least time of many repeats, visibility apart."""
    rng = np.random.default_rng(0)
    shape = (WORLDS, VEHICLES)
    world, scene = _worlds(rng.uniform(5, 60, shape), rng.uniform(-10, 10, shape)), _scene(VEHICLES)
    seen, levels = relative(world), np.full(shape, 4.0)
    variant = load(locate(model)).clean

    def box() -> Box:  # a box keeps its angles, so every repeat needs a fresh one
        return box_of(seen, scene.lengths, scene.widths, 1.7, levels)

    law = _least(lambda: variant.law(box(), 0.3))
    columns = _least(lambda: features(box(), variant.inputs))
    inputs = np.random.default_rng(1).normal(size=(WORLDS * VEHICLES, len(variant.inputs)))
    latents = _least(lambda: variant.latents.predict(inputs))
    rays = _least(lambda: visibility(world, scene))
    print(
        f"{seen.range.size} boxes: law {law:.2f} ms, of it features {columns:.2f} and latents {latents:.2f}; "
        f"visibility, apart, {rays:.2f} ms"
    )


def _least(call: Callable[[], object]) -> float:
    least = np.inf
    for _ in range(REPEATS):
        start = time.perf_counter()
        call()
        least = min(least, time.perf_counter() - start)
    return 1000 * float(least)


def _scene(count: int) -> Scene:
    lengths, widths = np.full(count, 4.3), np.full(count, 1.7)
    names = tuple(f"car{i}" for i in range(count))
    return Scene(0.1, Road((0.0,), 3.5), 4.3, 1.7, names, lengths, widths, np.ones(count, bool))


def _worlds(x: np.ndarray, y: np.ndarray) -> World:
    """Return a resting ego and cars around it, at (N, V) places."""
    none, nothing = np.zeros(len(x)), np.zeros_like(x)
    ego = Vehicles(none, none, none, none, none)
    return World(np.zeros(len(x), np.int64), ego, Vehicles(x, y, nothing, nothing, nothing), none)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="CSV that avrare pem convert wrote")
    parser.add_argument("--model", action="append", help="name or path; may be repeated")
    options = parser.parse_args()
    data = clean(read_table(options.data))
    for model in options.model or MODELS:
        print(f"\n{model}")
        held_out(model, data)
        counts(model, data)
        straight_ahead(model)
        timing(model)


if __name__ == "__main__":
    main()
