"""Training of two sparse variational Gaussian processes with Pyro: one for detection, one for errors."""

# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyro
import torch
from numpy.typing import NDArray
from pyro.contrib.gp.kernels import RBF
from pyro.contrib.gp.likelihoods.likelihood import Likelihood
from pyro.contrib.gp.models import VariationalSparseGP
from pyro.infer import TraceMeanField_ELBO
from pyro.nn.module import PyroParam
from scipy.cluster.vq import kmeans2
from torch import Tensor
from torch.distributions import StudentT, constraints

from avrare.protocols import Floats
from avrare_gp_pem.runtime.gp import DiagonalGp, GpPair, SparseGp
from avrare_pem_training.fit_networks import Sample

_FIRST_RATE, _LAST_RATE = 0.03, 0.0003


@dataclass(frozen=True)
class Schedule:
    """Optimisation of a process.

    Attributes:
        inducing: Number of inducing points.
        steps: Steps of Adam; its rate falls by a factor of 100 over them.
        batch: Rows per step.
        checks: Number of evaluations of the bound over all rows.
        seed: Seed of the batches and of the initial inducing points.
        weight: Weight of a row in the bound. Below 1, because rows are frames of scenes: a vehicle seen in
            ten consecutive frames is not ten vehicles, and a fit that counts it ten times is overconfident.
        diagonal: True for diagonal variational factors, three times as fast at run time.
    """

    inducing: int = 100
    steps: int = 8000
    batch: int = 512
    checks: int = 10
    seed: int = 0
    weight: float = 0.3
    diagonal: bool = False


SCHEDULE = Schedule(inducing=100, steps=2000, batch=256, checks=2, weight=0.3, diagonal=True)


def fit_gps(
    sample: Sample, schedule: Schedule, report: Callable[[str], None]
) -> tuple[GpPair, Floats, Floats, NDArray[np.intp]]:
    """Train on all rows except the last fifth, which calibration must not have seen.

    Args:
        sample: Rows in the order of recording; the first input is the range.
        schedule: Optimisation.
        report: Called with lines of progress.

    Returns:
        The processes, and for the rows left out: means and variances (m, 5), and their indices (m,).
    """
    rows = np.arange(len(sample.x))
    fitted, left_out = np.split(rows, [int(0.8 * len(rows))])
    detected = fitted[sample.detected[fitted]]
    default = torch.get_default_dtype()
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    try:
        processes = []
        for index, target, likelihood, latents in (
            (fitted, sample.detected[fitted][None].astype(float), ProbitDetection(), 1),
            (detected, sample.standard[detected].T, StudentErrors(), 4),
        ):
            fewer = replace(schedule, inducing=min(schedule.inducing, max(5, len(index) // 10)))
            process, _ = fit_process(sample.x[index], target, likelihood, latents, fewer, report)
            processes.append(process)
        pair = GpPair(*(export(process, diagonal=schedule.diagonal) for process in processes))
    finally:
        torch.set_default_dtype(default)
    mean, variance = pair.predict(sample.x[left_out])
    return pair, mean, variance, left_out


def fit_process(
    x: Floats,
    y: Floats,
    likelihood: Likelihood,
    latents: int,
    schedule: Schedule,
    report: Callable[[str], None],
    prior: torch.nn.Module | None = None,
) -> tuple[VariationalSparseGP, list[float]]:
    """Fit one process.

    Args:
        x: (n, D) normalised inputs.
        y: (..., n) targets.
        likelihood: Likelihood of the targets given the latents.
        latents: Number of latent functions.
        schedule: Optimisation.
        report: Called with a line after each check.
        prior: Prior mean; None: constant and slope over the first input.

    Returns:
        The process and the evidence lower bound per row at each check, over all rows.
    """
    rng = np.random.default_rng(schedule.seed)
    pyro.clear_param_store()  # names of parameters are global: a second process would get those of the first
    pyro.set_rng_seed(schedule.seed)
    centres, _ = kmeans2(x, schedule.inducing, minit="++", seed=rng)
    inputs, targets = torch.as_tensor(x), torch.as_tensor(y)
    process = VariationalSparseGP(
        inputs,
        targets,
        RBF(x.shape[1], lengthscale=torch.full((x.shape[1],), 2.0)),
        torch.as_tensor(centres),
        likelihood,
        mean_function=prior or _LinearPrior(latents),
        latent_shape=torch.Size([latents]),
        num_data=len(x) * schedule.weight,
        whiten=True,
        jitter=1e-5,
    )
    if schedule.diagonal:  # a factor that starts as the identity and gets no other gradient stays diagonal
        identity = torch.eye(schedule.inducing)
        process.u_scale_tril_unconstrained.register_hook(lambda gradient: gradient * identity)
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
    """Convert the fitted process to NumPy arrays; of ``diagonal`` factors only the diagonals."""

    def array(tensor: Any) -> Floats:  # Pyro declares its parameters as descriptors
        numbers: Floats = tensor.detach().numpy().astype(np.float64)
        return numbers

    process.set_mode("guide")
    prior: Any = process.mean_function
    factor = array(process.u_scale_tril)
    return (DiagonalGp if diagonal else SparseGp)(
        inducing=array(process.Xu),
        lengthscale=array(process.kernel.lengthscale),
        variance=array(process.kernel.variance),
        location=array(process.u_loc),
        factor=np.diagonal(factor, axis1=1, axis2=2).copy() if diagonal else factor,
        prior=array(prior.coefficients),
        jitter=np.array(process.jitter),
    )


class _LinearPrior(torch.nn.Module):
    """Prior mean: constant and slope over the first input (the range), one pair per latent function."""

    def __init__(self, latents: int) -> None:
        super().__init__()
        self.coefficients = torch.nn.Parameter(torch.zeros(latents, 2))

    def forward(self, x: Tensor) -> Tensor:
        return self.coefficients[:, :1] + self.coefficients[:, 1:] * x[:, 0]


class ProbitDetection(Likelihood):
    """Detected with probability Phi(f), so that f integrates out in closed form.

    Quadrature over the latent instead of Pyro's one sample per row and step makes the bound free of that
    noise.
    """

    def __init__(self, points: int = 12) -> None:
        super().__init__()
        self.nodes, self.weights = _gauss_hermite(points)

    def forward(self, f_loc: Tensor, f_var: Tensor, y: Tensor | None = None) -> Tensor:
        """Return the expected log likelihood of ``y`` (n,) in {0, 1}, given latents (n,)."""
        assert y is not None  # it scores targets, it does not sample them
        f: Tensor = f_loc + f_var.clamp(min=1e-12).sqrt() * self.nodes[:, None]
        expected: Tensor = (self.weights[:, None] * torch.special.log_ndtr(f * (2 * y - 1))).sum(0)
        pyro.factor("detections", expected.sum())
        return expected


class StudentErrors(Likelihood):
    """Two Student-t errors with latents (4, n), two locations and two log scales; by quadrature, too."""

    def __init__(self, points: int = 5) -> None:
        super().__init__()
        nodes, weights = _gauss_hermite(points)
        self.location_nodes = nodes.repeat_interleave(points)[:, None, None]
        self.scale_nodes = nodes.repeat(points)[:, None, None]
        self.weights = torch.outer(weights, weights).reshape(-1, 1, 1)
        self.dof = PyroParam(torch.full((2,), 3.0), constraints.greater_than(1.0))

    def forward(self, f_loc: Tensor, f_var: Tensor, y: Tensor | None = None) -> Tensor:
        """Return the expected log likelihood of standardised errors ``y`` (2, n), given latents (4, n)."""
        assert y is not None  # it scores targets, it does not sample them
        sd = f_var.clamp(min=1e-12).sqrt()
        location = f_loc[:2] + sd[:2] * self.location_nodes
        scale = torch.exp(f_loc[2:] + sd[2:] * self.scale_nodes)
        dof: Tensor = self.dof  # type: ignore[assignment]  # PyroParam is a descriptor
        density = StudentT(dof[:, None], location, scale, validate_args=False).log_prob(y)
        expected: Tensor = (self.weights * density).sum(0)
        pyro.factor("errors", expected.sum())
        return expected


def _gauss_hermite(points: int) -> tuple[Tensor, Tensor]:
    nodes, weights = np.polynomial.hermite_e.hermegauss(points)
    return torch.as_tensor(nodes), torch.as_tensor(weights / weights.sum())
