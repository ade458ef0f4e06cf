"""Fits the two Gaussian processes with Pyro. Needs the ``train`` extra."""

# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyro
import torch
from numpy.typing import NDArray
from pyro.contrib.gp.kernels import RBF
from pyro.contrib.gp.likelihoods.likelihood import Likelihood
from pyro.contrib.gp.models import VariationalSparseGP
from pyro.infer import TraceMeanField_ELBO
from scipy.cluster.vq import kmeans2
from scipy.optimize import minimize
from scipy.stats import t as student_t
from torch import Tensor

from avrare_gp_pem.diagonal_gp import DiagonalGp, diagonal_gp
from avrare_gp_pem.gp import SparseGp, sparse_gp

Floats = NDArray[np.float64]
_JITTER = 1e-5
_LEAST_SCALE = 1e-4  # errors may all be zero [m]
_FIRST_RATE, _LAST_RATE = 0.03, 0.0003


@dataclass(frozen=True)
class Schedule:
    """How to optimise.

    Attributes:
        inducing: Number of inducing points.
        steps: Steps of Adam; its rate falls by a factor of 100 over them.
        batch: Rows per step.
        checks: How often the bound over all rows is worked out.
        seed: Of the batches and of the first inducing points.
        weight: What a row counts in the bound. Below 1, because rows are frames of scenes: a vehicle that is
            seen in ten frames in a row is not ten vehicles, and a fit that takes it for ten is too sure.
        diagonal: Whether the variational factors are diagonal: three times as fast at run time.
    """

    inducing: int = 100
    steps: int = 8000
    batch: int = 512
    checks: int = 10
    seed: int = 0
    weight: float = 0.3
    diagonal: bool = False


class _LinearPrior(torch.nn.Module):
    """Prior mean: constant and slope over the first input (the range), one pair per latent function."""

    def __init__(self, latents: int) -> None:
        super().__init__()
        self.coefficients = torch.nn.Parameter(torch.zeros(latents, 2))

    def forward(self, x: Tensor) -> Tensor:
        return self.coefficients[:, :1] + self.coefficients[:, 1:] * x[:, 0]


def fit_process(
    x: Floats,
    y: Floats,
    likelihood: Likelihood,
    latents: int,
    schedule: Schedule,
    report: Callable[[str], None],
) -> tuple[VariationalSparseGP, list[float]]:
    """Fit one process.

    Args:
        x: (n, D) normalised inputs.
        y: (..., n) targets.
        likelihood: Of the targets given the latents.
        latents: Number of latent functions.
        schedule: How to optimise.
        report: Called with a line after each check.

    Returns:
        The process and the evidence lower bound per row at each check, over all rows.
    """
    rng = np.random.default_rng(schedule.seed)
    pyro.clear_param_store()  # names of parameters are global, a second process would get those of the first
    pyro.set_rng_seed(schedule.seed)
    centres, _ = kmeans2(x, schedule.inducing, minit="++", seed=rng)
    inputs, targets = torch.as_tensor(x), torch.as_tensor(y)
    process = VariationalSparseGP(
        inputs,
        targets,
        RBF(x.shape[1], lengthscale=torch.full((x.shape[1],), 2.0)),
        torch.as_tensor(centres),
        likelihood,
        mean_function=_LinearPrior(latents),
        latent_shape=torch.Size([latents]),
        num_data=len(x) * schedule.weight,
        whiten=True,
        jitter=_JITTER,
    )
    if schedule.diagonal:  # a factor that starts as the identity and gets no other gradient stays diagonal
        kept = torch.eye(schedule.inducing)
        process.u_scale_tril_unconstrained.register_hook(lambda gradient: gradient * kept)
    optimiser = torch.optim.Adam(process.parameters(), lr=_FIRST_RATE)
    decay = (_LAST_RATE / _FIRST_RATE) ** (1 / schedule.steps)
    loss = TraceMeanField_ELBO().differentiable_loss
    bounds: list[float] = []
    for step in range(schedule.steps):
        rows = rng.choice(len(x), min(schedule.batch, len(x)), replace=False)
        process.set_data(inputs[rows], targets[..., rows])
        optimiser.zero_grad()
        loss(process.model, process.guide).backward()
        optimiser.step()
        optimiser.param_groups[0]["lr"] *= decay
        if (step + 1) % max(1, schedule.steps // schedule.checks) == 0:
            process.set_data(inputs, targets)
            with torch.no_grad():
                bounds.append(-float(loss(process.model, process.guide)) / (len(x) * schedule.weight))
            report(f"step {step + 1}: bound per row {bounds[-1]:.5f}")
    return process, bounds


def export(process: VariationalSparseGP, *, diagonal: bool = False) -> SparseGp | DiagonalGp:
    """The fitted process as NumPy arrays; of ``diagonal`` factors only the diagonals."""

    def array(tensor: Any) -> Floats:  # Pyro declares its parameters as descriptors
        return tensor.detach().numpy().astype(np.float64)  # type: ignore[no-any-return]

    process.set_mode("guide")
    prior: Any = process.mean_function
    factor = array(process.u_scale_tril)
    return (diagonal_gp if diagonal else sparse_gp)(
        inducing=array(process.Xu),
        lengthscale=array(process.kernel.lengthscale),
        variance=array(process.kernel.variance),
        location=array(process.u_loc),
        factor=np.diagonal(factor, axis1=1, axis2=2).copy() if diagonal else factor,
        prior=array(prior.coefficients),
        jitter=np.array(process.jitter),
    )


def fit_base_scale(distance: Floats, errors: Floats) -> Floats:
    """(2, 2) Student-t scale of each column of ``errors`` (n, 2): at range 0 and per metre of range."""

    def one(error: Floats) -> Floats:
        def loss(parameters: Floats) -> float:
            base, slope, dof = np.exp(parameters)
            scale = np.maximum(base, _LEAST_SCALE) + slope * distance
            return -float(student_t.logpdf(error, dof, scale=scale).mean())

        best = minimize(loss, np.log([0.05, 0.005, 2.5]), method="Nelder-Mead")
        return np.maximum(np.exp(best.x[:2]), (_LEAST_SCALE, 0.0))  # type: ignore[no-any-return]

    return np.stack([one(errors[:, 0]), one(errors[:, 1])])
