"""Training of a flow with Pyro by maximum likelihood; needs torch and pyro-ppl (the extra ``train``)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from pyro import distributions
from pyro.distributions import transforms
from pyro.nn import AutoRegressiveNN, DenseNN

from avrare.base.errors import UsageError, did_you_mean
from avrare.protocols import Floats
from avrare_flows.flow import KINDS, AffineCoupling, Block, Flow, Network, SplineAutoregressive

_BATCH, _HELD_OUT, _LOOK = 512, 0.1, 50
_BINS, _LEAST_BOUND, _ROOM = 12, 5.0, 1.25
"""Bins of a spline; its least bound in standard deviations, and its bound over the farthest sample."""
_pyro: Any = distributions  # has no types of its own
_transforms: Any = transforms


@dataclass(frozen=True)
class Fit:
    """A fitted flow and its quality.

    Attributes:
        flow: The best flow on held-out samples.
        held_out: Its mean log density there, per row [nat].
        normal: Mean log density of a normal law with independent numbers, for comparison [nat].
        step: Training step of the flow.
    """

    flow: Flow
    held_out: float
    normal: float
    step: int


def fit(
    samples: Floats,
    kind: str = "affine_coupling",
    *,
    steps: int = 2000,
    seed: int = 0,
    blocks: int | None = None,
    hidden: int = 32,
    rate: float = 2e-3,
) -> Fit:
    """Fit a flow to rows of physical noise.

    Args:
        samples: (M, n), independent of each other.
        kind: One of ``avrare_flows.flow.KINDS``; one number a row needs ``spline_autoregressive``.
        steps: Number of Adam steps, on 512 rows each.
        seed: Seed of the first weights and of the order of the rows.
        blocks: Number of blocks; None: 6 couplings, or 2 splines.
        hidden: Width of the two hidden layers of a block's network.
        rate: First learning rate; it falls to 0 along a cosine.

    Raises:
        UsageError: The samples or an option do not fit.
    """
    data = _check_samples(samples, kind, steps, blocks, seed)
    many = blocks or {"affine_coupling": 6, "spline_autoregressive": 2}[kind]
    size = data.shape[1]
    order = np.random.default_rng(seed).permutation(len(data))
    held, fitting = np.split(data[order], [max(10, round(_HELD_OUT * len(data)))])
    shift, scale = _mean_and_deviation(fitting)
    bound = max(_LEAST_BOUND, _ROOM * float(np.abs((fitting - shift) / scale).max()))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        parts = [_pyro_transforms(kind, size, max(hidden, 2 * size), bound) for _ in range(many)]
        flow_blocks, loss, step = _descend(
            parts, size, (fitting - shift) / scale, (held - shift) / scale, steps, rate
        )
    extent = float(np.log(scale).sum())
    square = (((held - shift) / scale) ** 2).sum(axis=1).mean()
    normal = -0.5 * float(square) - 0.5 * size * math.log(2.0 * math.pi) - extent
    return Fit(Flow(kind, flow_blocks, shift, scale, len(data)), -loss - extent, normal, step)


def _check_samples(samples: Floats, kind: str, steps: int, blocks: int | None, seed: int) -> Floats:
    data = np.asarray(samples, dtype=np.float64)
    data = data[:, None] if data.ndim == 1 else data
    if kind not in KINDS:
        raise UsageError(f"unknown kind of flow {kind!r}", did_you_mean(kind, KINDS))
    fewest = 50
    if data.ndim != 2 or len(data) < fewest:
        raise UsageError(f"samples have shape {data.shape}", f"give at least {fewest} rows of noise, (M, n)")
    bad = np.flatnonzero(~np.isfinite(data).all(axis=1))
    if len(bad):
        numbers = ", ".join(f"{number:g}" for number in data[bad[0]])
        raise UsageError(
            f"row {bad[0] + 1} of the samples, {numbers}, is not finite",
            f"{len(bad)} of {len(data)} rows are like this",
        )
    if kind == "affine_coupling" and data.shape[1] < 2:
        raise UsageError("affine_coupling needs two numbers a row", "use --kind spline_autoregressive")
    if steps < 1 or (blocks is not None and blocks < 1):
        raise UsageError("a fit needs at least one step and one block")
    if not 0 <= seed < 2**63:
        raise UsageError(f"the seed must be at least 0 and below 2^63, not {seed}")
    return data


def _mean_and_deviation(samples: Floats) -> tuple[Floats, Floats]:
    with np.errstate(over="ignore", invalid="ignore"):
        shift, scale = samples.mean(axis=0), samples.std(axis=0)
    if not np.isfinite(scale).all():
        raise UsageError(
            "the samples are too large for their standard deviation", "give them in another unit"
        )
    still = np.flatnonzero(scale <= 1e-12 * np.abs(samples).max(axis=0))  # spread by rounding alone
    if len(still):
        raise UsageError(
            f"column {still[0] + 1} of the samples is constant, or nearly so",
            "leave it out: it needs no flow",
        )
    return shift, scale


def _pyro_transforms(kind: str, size: int, hidden: int, bound: float = _LEAST_BOUND) -> list[Any]:
    if kind == "affine_coupling":
        half = size // 2
        network: Any = DenseNN(half, [hidden, hidden], [size - half, size - half]).double()
        with torch.no_grad():  # begin near the identity
            network.layers[-1].weight.mul_(0.01)
        return [_transforms.AffineCoupling(half, network), _transforms.Permute(torch.arange(size).flip(0))]
    counts, order = [_BINS, _BINS, _BINS - 1], torch.arange(size)
    with warnings.catch_warnings():  # one number a row: a single spline, as intended
        warnings.simplefilter("ignore")
        masked = AutoRegressiveNN(size, [hidden, hidden], counts, permutation=order).double()  # type: ignore[arg-type]
    spline = _transforms.SplineAutoregressive
    return [spline(size, masked, count_bins=_BINS, bound=bound, order="quadratic")]


def _networks(parts: list[list[Any]]) -> Iterator[Any]:
    for part in parts:
        yield part[0].nn if isinstance(part[0], _transforms.AffineCoupling) else part[0].arn


def _descend(
    parts: list[list[object]], size: int, fitting: Floats, held: Floats, steps: int, rate: float
) -> tuple[tuple[Block, ...], float, int]:
    """Return the best blocks on ``held``, their mean negative log density there, and the step."""
    rows, test = torch.from_numpy(fitting), torch.from_numpy(held)
    weights = [weight for network in _networks(parts) for weight in network.parameters()]
    optimiser = torch.optim.Adam(weights, lr=rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    zero = torch.zeros(size, dtype=torch.float64)
    base = _pyro.Normal(zero, torch.ones_like(zero), validate_args=False).to_event(1)
    law = _pyro.TransformedDistribution(
        base, [transform for part in parts for transform in part], validate_args=False
    )
    best: tuple[tuple[Block, ...], float, int] = (), math.inf, 0
    for step in range(1, steps + 1):
        optimiser.zero_grad()
        loss = -law.log_prob(rows[torch.randint(len(rows), (_BATCH,))]).mean()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(weights, 10.0)
        optimiser.step()
        schedule.step()
        if step % _LOOK == 0 or step == steps:
            with torch.no_grad():
                held_loss = float(-law.log_prob(test).mean())
            if held_loss < best[1]:
                best = _export(parts), held_loss, step
    if not best[0]:
        raise UsageError("the fit has not reached a finite density", "look for outliers, or lower the rate")
    return best


def _export(parts: list[list[Any]]) -> tuple[Block, ...]:
    blocks: list[Block] = []
    for part, network in zip(parts, _networks(parts), strict=True):
        coupling = isinstance(part[0], _transforms.AffineCoupling)
        weights = tuple(
            (layer.weight if coupling else layer.weight * layer.mask).detach().numpy().copy()
            for layer in network.layers
        )
        biases = tuple(layer.bias.detach().numpy().copy() for layer in network.layers)
        both = Network(weights, biases)
        blocks.append(AffineCoupling(both) if coupling else SplineAutoregressive(both, part[0].spline.bound))
    return tuple(blocks)
