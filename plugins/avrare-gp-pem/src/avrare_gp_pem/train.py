"""Fits the first model: ``python -m avrare_gp_pem.train --inputs ... --labels ... --out DIR``.

This is how ``models/pointpillars.npz`` was made, kept so that it can be made again; for your own data use
``avrare pem fit``, which reads, checks, calibrates and reports more. Needs the ``train`` extra (torch, pyro,
scipy). Writes DIR/NAME.npz, and DIR/NAME.json with its metrics on the rows that were held out.
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

from avrare_gp_pem.data import Rows, read
from avrare_gp_pem.diagonal_gp import GpPair
from avrare_gp_pem.features import NAMES
from avrare_gp_pem.fit import Schedule, export, fit_base_scale, fit_process
from avrare_gp_pem.likelihoods import ProbitDetection, StudentErrors
from avrare_gp_pem.metrics import detection_metrics, error_metrics
from avrare_gp_pem.store import FittedPem, save
from avrare_gp_pem.variant import Variant


@dataclass(frozen=True)
class Training:
    """A fitted model and how the fit went.

    Attributes:
        model: What ``save`` writes.
        bounds: Evidence lower bound per row at each check, by process.
    """

    model: FittedPem
    bounds: dict[str, list[float]]


def train(rows: Rows, schedule: Schedule, limit: float, provenance: dict[str, str]) -> Training:
    """Fit both processes to ``rows``; single-threaded and deterministic in ``schedule.seed``."""
    default = torch.get_default_dtype()
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    try:
        return _train(rows, schedule, limit, provenance)
    finally:
        torch.set_default_dtype(default)


def _train(rows: Rows, schedule: Schedule, limit: float, provenance: dict[str, str]) -> Training:
    mean, sd = rows.inputs.mean(axis=0), rows.inputs.std(axis=0)
    sd = np.where(sd > 0, sd, 1.0)
    x = (rows.inputs - mean) / sd
    detection, detection_bounds = fit_process(
        x, rows.detected[None].astype(float), ProbitDetection(), 1, schedule, _say("detection")
    )
    detection_gp = export(detection)
    errors = rows.errors[rows.detected]
    distance = rows.inputs[rows.detected, 0]
    base = fit_base_scale(distance, errors)
    standard = errors / (base[:, 0] + base[:, 1] * distance[:, None])
    likelihood = StudentErrors()
    error, error_bounds = fit_process(x[rows.detected], standard.T, likelihood, 4, schedule, _say("error"))
    variant = Variant(
        latents=GpPair(detection_gp, export(error)),
        inputs=NAMES,
        input_mean=mean,
        input_sd=sd,
        base_scale=base,
        dof=likelihood.degrees(),
        limit=np.array(limit),
        link="probit",
        frame="vehicle",
    )
    return Training(
        FittedPem(variant, None, provenance), {"detection": detection_bounds, "error": error_bounds}
    )


def evaluate(model: FittedPem, rows: Rows, base_rate: float) -> dict[str, float]:
    """Metrics on ``rows``; see ``metrics``."""
    law = model.clean.law_of(rows.inputs, rows.inputs[:, 0], speed_sd=0.0)
    return detection_metrics(law.detect, rows.detected, base_rate) | error_metrics(law, rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
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
    result = train(train_rows, schedule, options.limit, provenance)
    report: dict[str, object] = dict(evaluate(result.model, test_rows, float(train_rows.detected.mean())))
    report |= {"dof": result.model.clean.dof.tolist(), "bounds": result.bounds}
    options.out.mkdir(parents=True, exist_ok=True)
    save(options.out / f"{options.name}.npz", result.model)
    (options.out / f"{options.name}.json").write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))
    print(f"{time.process_time() - start:.0f} s of CPU", file=sys.stderr)


def _say(name: str) -> Callable[[str], None]:
    return lambda line: print(f"{name}: {line}", file=sys.stderr, flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m avrare_gp_pem.train", description=(__doc__ or "").split(":")[0]
    )
    parser.add_argument("--inputs", type=Path, required=True, help="text file of vehicles")
    parser.add_argument("--labels", type=Path, required=True, help="text file of detections and errors")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--name", default="model", help="name of the model")
    parser.add_argument("--inducing", type=int, default=100, help="inducing points of each process")
    parser.add_argument("--steps", type=int, default=8000, help="optimisation steps of each process")
    parser.add_argument("--batch", type=int, default=512, help="rows per step")
    parser.add_argument("--weight", type=float, default=0.3, help="what a row counts: rows are correlated")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--oblique", type=float, default=10.0, help="drop vehicles nearer to an axis [deg]")
    parser.add_argument("--limit", type=float, default=8.0, help="largest error [m]")
    parser.add_argument("--provenance", nargs="*", default=[], metavar="KEY=TEXT", help="stored in the model")
    return parser


if __name__ == "__main__":
    main()
