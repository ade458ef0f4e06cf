"""Training of the perception model as the STL-AMS paper describes it (Innes and Ramamoorthy, section IV).

Two sparse variational Gaussian processes with an RBF kernel and 100 inducing points, of seven inputs: a
classifier of detections, and a regressor of the errors to the right and forward with normal noise. Nothing
is calibrated, and no row counts less than another. What the paper leaves open: the kernel has a length scale
for each input, the prior mean is a constant, the classifier's link is probit.
"""

# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pyro
import torch
from pyro.contrib.gp.likelihoods.likelihood import Likelihood
from pyro.nn.module import PyroParam
from torch import Tensor
from torch.distributions import constraints

from avrare_gp_pem.runtime.gp import NormalErrorGps
from avrare_pem_training.fit_gp import ProbitDetection, Schedule, export, fit_process
from avrare_pem_training.fit_networks import Sample

LITERAL_SCHEDULE = Schedule(inducing=100, steps=3000, batch=256, checks=3, weight=1.0)
_ERRORS = 2


def fit_literal(sample: Sample, schedule: Schedule, report: Callable[[str], None]) -> NormalErrorGps:
    """Train both processes on all rows.

    Args:
        sample: Rows in the order of recording.
        schedule: Optimisation.
        report: Called with lines of progress.
    """
    default = torch.get_default_dtype()
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    try:
        noise = NormalErrors()
        processes = []
        for rows, target, likelihood, latents in (
            (slice(None), sample.detected[None].astype(float), ProbitDetection(), 1),
            (sample.detected, sample.standard[sample.detected].T, noise, _ERRORS),
        ):
            x = sample.x[rows]
            fewer = replace(schedule, inducing=min(schedule.inducing, max(5, len(x) // 10)))
            prior = _ConstantPrior(latents)
            process, _ = fit_process(x, target, likelihood, latents, fewer, report, prior)
            processes.append(export(process))
        variance: Tensor = noise.variance  # type: ignore[assignment]  # PyroParam is a descriptor
        log_noise = 0.5 * np.log(variance.detach().numpy())
    finally:
        torch.set_default_dtype(default)
    detection, error = processes
    return NormalErrorGps(detection, error, log_noise.astype(np.float64))


class _ConstantPrior(torch.nn.Module):
    """Prior mean: one constant per latent function."""

    def __init__(self, latents: int) -> None:
        super().__init__()
        self.constant = torch.nn.Parameter(torch.zeros(latents, 1))

    @property
    def coefficients(self) -> Tensor:
        """(L, 2) constants, and slopes of zero."""
        return torch.cat([self.constant, torch.zeros_like(self.constant)], dim=1)

    def forward(self, x: Tensor) -> Tensor:
        return self.constant.expand(-1, len(x))


class NormalErrors(Likelihood):
    """Errors with normal noise of one variance each; its expectation over the latents is in closed form."""

    def __init__(self) -> None:
        super().__init__()
        self.variance = PyroParam(torch.ones(_ERRORS), constraints.positive)

    def forward(self, f_loc: Tensor, f_var: Tensor, y: Tensor | None = None) -> Tensor:
        """Return the expected log likelihood of standardised errors ``y`` (2, n), given latents (2, n)."""
        assert y is not None  # it scores targets, it does not sample them
        variance: Tensor = self.variance  # type: ignore[assignment]  # PyroParam is a descriptor
        variance = variance[:, None]
        square = (y - f_loc) ** 2 + f_var
        expected = -0.5 * (math.log(2 * math.pi) + variance.log() + square / variance)
        pyro.factor("errors", expected.sum())
        return expected
