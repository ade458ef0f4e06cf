"""The figures of a perception model's card, from the fitted model itself.

    python benchmarks/pem_card.py --inputs nuscenes_inputs.txt --labels nuscenes_labels.txt

Prints the scores on the held-out rows and, for a car straight ahead in full view, how often it is detected
and how far off. Needs the training extra of avrare-gp-pem (scipy), but trains nothing.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from avrare.batch import take
from avrare.driving import Road, Scene, Vehicles, World
from avrare_gp_pem.config import GpPemConfig
from avrare_gp_pem.data import read
from avrare_gp_pem.law import NOISE_PER_VEHICLE
from avrare_gp_pem.metrics import detection_metrics, error_metrics
from avrare_gp_pem.model import build_gp, predict_features
from avrare_gp_pem.store import load, locate

RANGES = (5.0, 10.0, 20.0, 30.0, 40.0, 45.0, 50.0, 55.0, 60.0)
SAMPLES = 100_000


def held_out(model: str, inputs: Path, labels: Path, oblique: float) -> None:
    """Scores on the rows that training leaves out."""
    train_rows, rows = read(inputs, labels, oblique)
    law = predict_features(load(locate(model)), rows.inputs, speed_sd=0.0)
    base_rate = float(train_rows.detected.mean())
    scores = detection_metrics(law.detect, rows.detected, base_rate) | error_metrics(law, rows)
    for name, value in scores.items():
        print(f"{name:28s} {value:.4f}")


def straight_ahead(model: str) -> None:
    """Detection and errors of an aligned car at several ranges."""
    size = np.array([4.3])
    scene = Scene(0.1, Road((0.0,), 3.5), 4.3, 1.7, ("car",), size, np.array([1.7]), np.array([True]))
    pem = build_gp(GpPemConfig(model=model), scene)
    print("range [m]   P(detect)   sd along [m]   sd across [m]   mean along [m]")
    for distance in RANGES:
        world = _worlds(distance, SAMPLES)
        law = pem.law(take(world, slice(0, 1)))
        noise = np.random.default_rng(0).normal(size=(SAMPLES, NOISE_PER_VEHICLE))
        noise[:, 0] = -9.0  # always seen: errors of the seen ones
        seen = pem.observe(world, noise)
        along, across = distance - seen.x[:, 0], -seen.y[:, 0]
        print(
            f"{distance:9.0f} {float(law.detect[0, 0]):11.3f} {np.nanstd(along):14.2f}"
            f" {np.nanstd(across):15.2f} {np.nanmean(along):16.2f}"
        )


def _worlds(distance: float, n: int) -> World:
    """``n`` times a resting ego and one car ahead of it."""
    none, column = np.zeros(n), np.zeros((n, 1))
    ego = Vehicles(none, none, none, none, none)
    car = Vehicles(column + distance, column, column, column, column)
    return World(np.zeros(n, dtype=np.int64), ego, car, none)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--inputs", type=Path, required=True)
    parser.add_argument("--labels", type=Path, required=True)
    parser.add_argument("--model", default="pointpillars")
    parser.add_argument("--oblique", type=float, default=10.0, help="least angle to the ego's axes [deg]")
    options = parser.parse_args()
    held_out(options.model, options.inputs, options.labels, options.oblique)
    straight_ahead(options.model)


if __name__ == "__main__":
    main()
