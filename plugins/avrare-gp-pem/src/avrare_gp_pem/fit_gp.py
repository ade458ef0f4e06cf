"""Trains the two sparse variational Gaussian processes with Pyro. Needs the ``train`` extra."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from avrare_gp_pem.diagonal_gp import GpPair
from avrare_gp_pem.fit import Schedule, export, fit_process
from avrare_gp_pem.fit_networks import Sample
from avrare_gp_pem.likelihoods import ProbitDetection, StudentErrors

Floats = NDArray[np.float64]
SCHEDULE = Schedule(inducing=100, steps=2000, batch=256, checks=2, weight=0.3, diagonal=True)
_ERROR_LATENTS = 4


def fit_gps(
    sample: Sample, schedule: Schedule, report: Callable[[str], None]
) -> tuple[GpPair, Floats, Floats, NDArray[np.intp]]:
    """Train on all rows but the last fifth, which calibration needs unseen.

    Args:
        sample: Rows in the order of recording; the first input is the range.
        schedule: How to optimise.
        report: Called with lines of progress.

    Returns:
        The processes, and for the rows left out: means and variances (m, 5), and which rows they are (m,).
    """
    rows = np.arange(len(sample.x))
    fitted, left_out = np.split(rows, [int(0.8 * len(rows))])
    seen = fitted[sample.detected[fitted]]
    default = torch.get_default_dtype()
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    try:
        processes = [
            fit_process(
                sample.x[index], target, likelihood, latents, _no_more_than(schedule, len(index)), report
            )[0]
            for index, target, likelihood, latents in (
                (fitted, sample.detected[fitted][None].astype(float), ProbitDetection(), 1),
                (seen, sample.standard[seen].T, StudentErrors(), _ERROR_LATENTS),
            )
        ]
        pair = GpPair(*(export(process, diagonal=schedule.diagonal) for process in processes))
    finally:
        torch.set_default_dtype(default)
    mean, variance = pair.predict(sample.x[left_out])
    return pair, mean, variance, left_out


def _no_more_than(schedule: Schedule, rows: int) -> Schedule:
    """Fewer inducing points where rows are few."""
    return replace(schedule, inducing=min(schedule.inducing, max(5, rows // 10)))
