"""Two-phase sampling: which tapes of a cheap twin to run again on the stack itself (Neyman 1938).

Phase one runs the twin on N tapes and sorts them into bands: its failures first, then what it passed by ever
more. Phase two runs a tape of band b again with probability r_b. With the n_b failures of the stack found in
band b, the sum of n_b / (N r_b) is an unbiased estimate of its failure probability, whatever the twin is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.base.special_functions import bisect
from avrare.protocols import Bools, Floats

Integers = NDArray[np.int64]

SHARES = (0.01, 0.04, 0.16, 0.5)
"""Shares of the tapes that the twin passed which lie below the limits of its bands."""
_HALF = 0.5
"""Failures of the stack that a pilot is taken to have seen beyond those that it saw, evenly over its tapes:
where none was seen, some may still be."""
_LEAST_RATE = 0.005
GAIN = 1.3
"""Foreseen gain below which plain Monte Carlo is taken: the pilot may be wrong by some."""
_LOSS = 0.95
"""Foreseen gain that no specification may fall below for the sake of the others."""


@dataclass(frozen=True)
class Bands:
    """Bands of the twin's outcomes, for one specification.

    Attributes:
        limits: (B - 2,) ascending robustness between the bands of tapes that the twin passed.
        rates: (B,) probability that a tape of each band is run again; band 0 has the twin's failures.
    """

    limits: Floats
    rates: Floats

    def of(self, violated: Bools, robustness: Floats) -> Integers:
        """Return the band (n,) of tapes by the twin's verdict and robustness, NaN where it broke down."""
        passed = ~violated & ~np.isnan(robustness)
        return np.where(passed, 1 + np.searchsorted(self.limits, robustness, side="right"), 0)


@dataclass(frozen=True)
class Design:
    """Plan of a two-phase estimate of S specifications, made from a pilot and then fixed.

    Attributes:
        bands: One for each specification.
        cost: Cost of a rollout of the twin, in rollouts of the stack.
        rate: Share of the tapes that are expected to be run again.
        gains: (S,) foreseen gain over Monte Carlo at the same cost; NaN where the pilot saw no failure.
        correlations: (S,) correlation of the two verdicts in the pilot; NaN where one of them never failed.
    """

    bands: tuple[Bands, ...]
    cost: float
    rate: float
    gains: Floats
    correlations: Floats

    @property
    def pays(self) -> bool:
        """True where a gain is foreseen that is worth taking, and no loss."""
        gains = self.gains[~np.isnan(self.gains)]
        return bool(len(gains)) and bool(gains.min() >= _LOSS) and float(np.log(gains).mean()) >= np.log(GAIN)

    def rates(self, violated: Bools, robustness: Floats) -> Floats:
        """Return the probability (n,) that each tape is run again, from the twin's outcomes (n, S)."""
        rates = [band.rates[band.of(violated[:, k], robustness[:, k])] for k, band in enumerate(self.bands)]
        return np.asarray(np.max(rates, axis=0))


def scale_rates(rates: Floats, expected: float) -> tuple[Floats, float]:
    """Scale the rates (n,) below 1 to an expected number of tapes that run again; return also the factor.

    The twin's outcomes decide it, and nothing else, so that the estimate stays unbiased.
    """
    target = min(max(expected, 1.0), float(len(rates)))
    factor = bisect(lambda log: float(np.minimum(rates * np.exp(log), 1.0).sum()), target, -20.0, 20.0)
    return np.minimum(rates * np.exp(factor), 1.0), float(np.exp(factor))


def plan_design(twin: Bools, robustness: Floats, stack: Bools, cost: float) -> Design:
    """Plan the second phase.

    Args:
        twin: (n, S) tapes of the pilot that the twin failed.
        robustness: (n, S) robustness under the twin, NaN where it broke down.
        stack: (n, S) tapes that the stack failed, or broke down on.
        cost: Cost of a rollout of the twin, in rollouts of the stack.
    """
    plans = [_plan(*columns, cost) for columns in zip(twin.T, robustness.T, stack.T, strict=True)]
    bands = tuple(band for band, _ in plans)
    design = Design(bands, cost, 1.0, np.zeros(0), np.zeros(0))
    rates = design.rates(twin, robustness)
    rate = float(rates.mean())
    seen = [bool(column.any()) for column in stack.T]
    gains = [
        float(chances.mean() / ((chances / rates).mean() * (cost + rate))) if failed else np.nan
        for (_, chances), failed in zip(plans, seen, strict=True)
    ]
    correlations = list(map(_correlation, twin.T, stack.T))
    return Design(bands, cost, rate, np.array(gains), np.array(correlations))


def _plan(twin: Bools, robustness: Floats, stack: Bools, cost: float) -> tuple[Bands, Floats]:
    """Return the bands of a specification and the chance (n,) that the stack fails each tape of the pilot."""
    passed = robustness[~twin & ~np.isnan(robustness)]
    limits = np.unique(np.quantile(passed, SHARES)) if len(passed) else np.zeros(0)
    band = Bands(limits, limits).of(twin, robustness)
    sizes = np.bincount(band, minlength=len(limits) + 2).astype(np.float64)
    failures = np.bincount(band[stack], minlength=len(sizes)).astype(np.float64)
    chances = _chances(failures, sizes)
    shares = sizes / len(band)
    # Var is proportional to sum(share chance / rate), the cost to cost + sum(share rate): Neyman's
    # allocation has rates proportional to the roots of the chances, and the factor is found by trial.
    factors = np.logspace(-3.0, 4.0, 281)  # between the rates and the roots of the probabilities
    rates = np.clip(factors[:, None] * np.sqrt(chances), _LEAST_RATE, 1.0)
    product = ((shares * chances) / rates).sum(axis=1) * (cost + (shares * rates).sum(axis=1))
    best = rates[int(np.argmin(product))]
    return Bands(limits, best), chances[band]


def _chances(failures: Floats, sizes: Floats) -> Floats:
    """Return the chance of a failure in each band, never rising with the margin of the twin."""
    total = sizes.sum()
    blocks: list[tuple[float, float, int]] = []  # failures, tapes and bands that share one chance
    for failed, size in zip(failures, sizes, strict=True):
        block = (float(failed), float(size), 1)
        while blocks and block[0] * blocks[-1][1] >= blocks[-1][0] * block[1]:  # also where one is empty
            before = blocks.pop()
            block = (before[0] + block[0], before[1] + block[1], before[2] + block[2])
        blocks.append(block)
    levels = [failed / max(size, 1.0) + _HALF / total for failed, size, _ in blocks]
    return np.asarray(np.minimum(np.repeat(levels, [count for *_, count in blocks]), 1.0))


def _correlation(twin: Bools, stack: Bools) -> float:
    if twin.all() or stack.all() or not (twin.any() and stack.any()):
        return float("nan")
    return float(np.corrcoef(twin, stack)[0, 1])
