"""Training of the published model ``pointpillars`` of avrare-gp-pem.

    python benchmarks/train_pointpillars.py --inputs inputs.txt --labels labels.txt --out DIR

For your own data use ``avrare pem fit``, which also checks, calibrates and reports. Needs the ``train``
extra (torch, pyro, scipy). Writes DIR/NAME.npz, and DIR/NAME.json with the bounds on the evidence and the
shares of large errors in the held-out rows.

Two text files hold one row per vehicle. Inputs: x (right), y (forward), yaw, length, width, height,
visibility category. Labels: detected, error in x, y and yaw (truth minus estimate), -1000 where undetected.
Of rows with the same inputs only the first is used, and only vehicles more than ``--oblique`` degrees off
both axes of the ego (see ``avrare_pem_training.cleaning`` for the artefact of label matching). Errors of
yaw are not modelled.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import ndtri

from avrare_gp_pem.runtime.features import NAMES, Box, features
from avrare_gp_pem.runtime.gp import GpPair
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.store import save
from avrare_gp_pem.runtime.student_t import student
from avrare_gp_pem.runtime.variant import FittedPem, Variant
from avrare_pem_training.cleaning import off_axis
from avrare_pem_training.fit_gp import ProbitDetection, Schedule, StudentErrors, export, fit_process
from avrare_pem_training.pipeline import fit_base_scale

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Rows:
    """Vehicles and their detections.

    Attributes:
        inputs: (n, 10) features.
        detected: (n,) outcomes.
        errors: (n, 2) truth minus estimate along and across the vehicle [m]; NaN where missed.
    """

    inputs: Floats
    detected: NDArray[np.bool_]
    errors: Floats

    def take(self, index: NDArray[np.bool_] | slice) -> Rows:
        """Select rows."""
        return Rows(self.inputs[index], self.detected[index], self.errors[index])


def read(inputs: Path, labels: Path, oblique: float) -> tuple[Rows, Rows]:
    """Read training and test rows.

    Args:
        inputs: File of inputs.
        labels: File of labels.
        oblique: Rows nearer than this to an axis of the ego are dropped [degrees]; 0 keeps all.

    Returns:
        The first 80 % and the last 20 % of the rows: neighbours are frames of one scene, so that a random
        split would test on scenes of the training rows.
    """
    x, y = np.loadtxt(inputs, ndmin=2), np.loadtxt(labels, ndmin=2)
    if x.shape[1:] != (7,) or y.shape != (len(x), 4):
        raise ValueError(f"expected 7 columns of inputs and 4 of labels, got {x.shape} and {y.shape}")
    _, first = np.unique(x, axis=0, return_index=True)
    first.sort()
    x, y = x[first], y[first]
    training = np.arange(len(x)) < int(0.8 * len(x))
    keep = off_axis(x[:, 2]) >= oblique
    rows = to_rows(x, y)
    return rows.take(keep & training), rows.take(keep & ~training)


def to_rows(x: Floats, y: Floats) -> Rows:
    """Convert raw columns to features and labels."""
    detected = y[:, 0] == 1
    cos, sin = np.cos(x[:, 2]), np.sin(x[:, 2])
    errors = np.stack([cos * y[:, 1] + sin * y[:, 2], cos * y[:, 2] - sin * y[:, 1]], axis=-1)
    errors[~detected] = np.nan
    return Rows(features(Box(*x.T)), detected, errors)


def train(
    rows: Rows, schedule: Schedule, limit: float, provenance: dict[str, str]
) -> tuple[FittedPem, dict[str, list[float]]]:
    """Fit both processes to ``rows``; single-threaded and deterministic in ``schedule.seed``.

    Returns:
        The model, and for each process the evidence lower bound per row at each check.
    """
    default = torch.get_default_dtype()
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    try:
        return _train(rows, schedule, limit, provenance)
    finally:
        torch.set_default_dtype(default)


def _train(
    rows: Rows, schedule: Schedule, limit: float, provenance: dict[str, str]
) -> tuple[FittedPem, dict[str, list[float]]]:
    mean, sd = rows.inputs.mean(axis=0), rows.inputs.std(axis=0)
    sd = np.where(sd > 0, sd, 1.0)
    x = (rows.inputs - mean) / sd
    detection, detection_bounds = fit_process(
        x, rows.detected[None].astype(float), ProbitDetection(), 1, schedule, _log("detection")
    )
    detection_gp = export(detection)
    errors = rows.errors[rows.detected]
    distance = rows.inputs[rows.detected, 0]
    base = fit_base_scale(distance, errors)
    standard = errors / (base[:, 0] + base[:, 1] * distance[:, None])
    likelihood = StudentErrors()
    error, error_bounds = fit_process(x[rows.detected], standard.T, likelihood, 4, schedule, _log("error"))
    variant = Variant(
        latents=GpPair(detection_gp, export(error)),
        inputs=NAMES,
        input_mean=mean,
        input_sd=sd,
        base_scale=base,
        dof=likelihood.dof.detach().numpy().copy(),  # type: ignore[operator]  # PyroParam is a descriptor
        limit=np.array(limit),
        link="probit",
        frame="vehicle",
    )
    return FittedPem(variant, None, provenance), {"detection": detection_bounds, "error": error_bounds}


def count_large_errors(law: ObservationLaw, rows: Rows) -> dict[str, float]:
    """Return how often the normal score of an error along and across exceeds 1, 2, 3, 4."""
    shares: dict[str, float] = {}
    for axis, name in enumerate(("along", "across")):
        scale = law.scale[rows.detected, axis]
        standard = (rows.errors[rows.detected, axis] - law.location[rows.detected, axis]) / scale
        bound, distribution = law.limit / scale, student(law.dof[axis])
        beyond = distribution.upper_tail(bound)
        tail = (distribution.upper_tail(np.abs(standard)) - beyond) / (1 - 2 * beyond)
        normal_score = -ndtri(np.clip(tail, 1e-15, 0.5))
        shares |= {f"error_beyond_{k}_{name}": float((normal_score > k).mean()) for k in (1, 2, 3, 4)}
    return shares


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    options = _parser().parse_args(arguments)
    schedule = Schedule(
        options.inducing, options.steps, options.batch, seed=options.seed, weight=options.weight
    )
    train_rows, test_rows = read(options.inputs, options.labels, options.oblique)
    provenance = dict(pair.split("=", 1) for pair in options.provenance)
    provenance |= {
        "rows": f"{len(train_rows.detected)} training, {len(test_rows.detected)} held out",
        "settings": f"oblique={options.oblique} {schedule}",
    }
    start = time.process_time()
    model, bounds = train(train_rows, schedule, options.limit, provenance)
    law = model.clean.law_from_columns(test_rows.inputs, test_rows.inputs[:, 0], speed_sd=0.0)
    report = {**count_large_errors(law, test_rows), "dof": model.clean.dof.tolist(), "bounds": bounds}
    options.out.mkdir(parents=True, exist_ok=True)
    save(options.out / f"{options.name}.npz", model)
    (options.out / f"{options.name}.json").write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))
    print(f"{time.process_time() - start:.0f} s of CPU", file=sys.stderr)


def _log(name: str) -> Callable[[str], None]:
    return lambda line: print(f"{name}: {line}", file=sys.stderr, flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--inputs", type=Path, required=True, help="text file of vehicles")
    parser.add_argument("--labels", type=Path, required=True, help="text file of detections and errors")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--name", default="model", help="name of the model")
    parser.add_argument("--inducing", type=int, default=100, help="inducing points of each process")
    parser.add_argument("--steps", type=int, default=8000, help="optimisation steps of each process")
    parser.add_argument("--batch", type=int, default=512, help="rows per step")
    parser.add_argument("--weight", type=float, default=0.3, help="weight of a row: rows are correlated")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--oblique", type=float, default=10.0, help="drop vehicles nearer to an axis [deg]")
    parser.add_argument("--limit", type=float, default=8.0, help="largest error [m]")
    parser.add_argument("--provenance", nargs="*", default=[], metavar="KEY=TEXT", help="stored in the model")
    return parser


if __name__ == "__main__":
    main()
