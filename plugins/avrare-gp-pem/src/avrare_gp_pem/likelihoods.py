"""Likelihoods for Pyro's sparse Gaussian processes, with the expectation over the latent done by quadrature.

Pyro's own draw one sample of the latent per row and step; quadrature makes the bound free of that noise.
"""

# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

import numpy as np
import pyro
import torch
from numpy.typing import NDArray
from pyro.contrib.gp.likelihoods.likelihood import Likelihood
from pyro.nn.module import PyroParam
from torch import Tensor
from torch.distributions import StudentT, constraints


def _gauss_hermite(points: int) -> tuple[Tensor, Tensor]:
    """Nodes and weights of the expectation over a standard normal."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(points)
    return torch.as_tensor(nodes), torch.as_tensor(weights / weights.sum())


class ProbitDetection(Likelihood):
    """Detected with probability Phi(f), so that f integrates out in closed form."""

    def __init__(self, points: int = 12) -> None:
        super().__init__()
        self.nodes, self.weights = _gauss_hermite(points)

    def forward(self, f_loc: Tensor, f_var: Tensor, y: Tensor | None = None) -> Tensor:
        """Expected log likelihood of ``y`` (n,) in {0, 1}, given latents (n,)."""
        if y is None:
            raise ValueError("this likelihood scores, it does not sample")
        f: Tensor = f_loc + f_var.clamp(min=1e-12).sqrt() * self.nodes[:, None]
        expected: Tensor = (self.weights[:, None] * torch.special.log_ndtr(f * (2 * y - 1))).sum(0)
        pyro.factor("detections", expected.sum())
        return expected


class StudentErrors(Likelihood):
    """Two Student-t errors whose location and log scale are latent: (4, n), two locations and two logs."""

    def __init__(self, points: int = 5) -> None:
        super().__init__()
        nodes, weights = _gauss_hermite(points)
        self.location_nodes = nodes.repeat_interleave(points)[:, None, None]
        self.scale_nodes = nodes.repeat(points)[:, None, None]
        self.weights = torch.outer(weights, weights).reshape(-1, 1, 1)
        self.dof = PyroParam(torch.full((2,), 3.0), constraints.greater_than(1.0))

    def forward(self, f_loc: Tensor, f_var: Tensor, y: Tensor | None = None) -> Tensor:
        """Expected log likelihood of standardised errors ``y`` (2, n), given latents (4, n)."""
        if y is None:
            raise ValueError("this likelihood scores, it does not sample")
        sd = f_var.clamp(min=1e-12).sqrt()
        location = f_loc[:2] + sd[:2] * self.location_nodes
        scale = torch.exp(f_loc[2:] + sd[2:] * self.scale_nodes)
        dof: Tensor = self.dof  # type: ignore[assignment]  # PyroParam is a descriptor
        density = StudentT(dof[:, None], location, scale, validate_args=False).log_prob(y)
        expected: Tensor = (self.weights * density).sum(0)
        pyro.factor("errors", expected.sum())
        return expected

    def degrees(self) -> NDArray[np.float64]:
        """(2,) degrees of freedom of the two errors."""
        dof: Tensor = self.dof  # type: ignore[assignment]
        return dof.detach().numpy().copy()
