"""Worlds, a model and made-up drives that the tests share."""

import numpy as np
import pytest

from avrare_pem_training.table import make_table
from perception_scenes import make, pointpillars

__all__ = ["make", "pointpillars"]


def made_up_drive(n, artefact=False, rate=None, seed=0):
    """Return rows with a known law: logistic detection, Student-t errors along and across; flips of yaw."""
    rng = np.random.default_rng(seed)
    distance, bearing = rng.uniform(3, 80, n), rng.uniform(-np.pi, np.pi, n)
    yaw = rng.uniform(-np.pi, np.pi, n)
    aligned = rng.uniform(size=n) < 0.5
    yaw = np.where(aligned, np.round(yaw / (np.pi / 2)) * np.pi / 2 + rng.normal(0, 0.005, n), yaw)
    detect = np.asarray(true_detection(distance) if rate is None else np.full(n, rate))
    if artefact:
        detect = np.where(aligned, 0.4 * detect, detect)
    along, across = true_scales(distance) * rng.standard_t(3, (2, n))
    cos, sin = np.cos(yaw), np.sin(yaw)
    flips = np.where(rng.uniform(size=n) < 0.1, np.pi, 0.0)
    return make_table(
        {
            "right": distance * np.cos(bearing),
            "forward": distance * np.sin(bearing),
            "yaw": yaw,
            "length": rng.normal(4.6, 0.3, n),
            "width": rng.normal(1.9, 0.1, n),
            "height": rng.normal(1.7, 0.1, n),
            "visibility": rng.integers(1, 5, n).astype(float),
            "detected": (rng.uniform(size=n) < detect).astype(float),
            "error_right": cos * along - sin * across,
            "error_forward": sin * along + cos * across,
            "error_yaw": np.abs(flips - np.abs(0.02 * rng.standard_t(3, n))),
        }
    )


def true_detection(distance):
    return 0.97 / (1 + np.exp((distance - 45) / 5))


def true_scales(distance):
    return np.stack([0.05 + 0.006 * distance, 0.03 + 0.003 * distance])


@pytest.fixture(scope="session")
def drive():
    """Return a function that makes up a table, with the true law as its attributes."""
    made_up_drive.detection, made_up_drive.scales = true_detection, true_scales
    return made_up_drive
