"""Effect of a flow's weights on an estimate: none, those of stl-ess (Eq. 20), and P/q.

    python -m benchmarks.unseen --problems-file benchmarks/flows.py --estimator ess --set chains=100
    OMP_NUM_THREADS=1 nice python benchmarks/flows.py [SAMPLES]

The first makes estimates with exact flows and wrong ones. The second fits flows to samples of the noise and
estimates with them.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import avrare
from avrare.protocols import Floats
from avrare.testing import normal
from avrare.testing.static_problems import Static, Values, row_sum
from avrare_flows.laws import Joint
from avrare_flows.marginals import Exponential, LogNormal
from avrare_flows.system import transform_noise
from avrare_flows.weights import WarpedLaw, weigh_noise

RUNS = 10


class Total(Static):
    """The physical numbers added up."""

    def signals(self, state: Values) -> dict[str, Floats]:
        """Return ``total`` (N,)."""
        return {"total": row_sum(state.values)}


class Product(Static):
    """The physical numbers multiplied."""

    def signals(self, state: Values) -> dict[str, Floats]:
        """Return ``total`` (N,), of their logarithms."""
        with np.errstate(divide="ignore"):
            return {"total": row_sum(np.log(state.values))}


@dataclass(frozen=True, eq=False)
class Stretched:
    """A law whose normal numbers are stretched first: a flow that has the scale a little wrong."""

    law: Joint
    factor: float
    note: str = "stretched"

    @property
    def noise_size(self) -> int:
        """Numbers of a row."""
        return self.law.noise_size

    def physical(self, z: Floats) -> Floats:
        """Return physical rows."""
        return self.law.physical(self.factor * z)

    def warp(self, z: Floats) -> tuple[Floats, Floats]:
        """Return physical rows and log |det|."""
        x, log_det = self.law.warp(self.factor * z)
        return x, log_det + self.noise_size * math.log(self.factor)


@dataclass(frozen=True, eq=False)
class Case:
    """A problem over physical noise, a flow for it, and the truth."""

    system: Static
    level: float
    meant: Joint
    flow: WarpedLaw
    truth: float

    def problem(self, weights: str) -> avrare.Problem:
        """Make the problem without weights, with those of the paper, or with P/q."""
        system: Any
        if weights == "none":
            system = transform_noise(self.system, self.flow)
        elif weights == "paper":
            system = weigh_noise(self.system, self.flow, weights="paper")
        else:
            system = weigh_noise(self.system, self.flow, self.meant.log_density)
        return avrare.Problem(system, avrare.stl(f"total < {self.level!r}"), steps=0)


def erlang(c: float, dim: int) -> float:
    return math.fsum(math.exp(j * math.log(c) - c - math.lgamma(j + 1)) for j in range(dim))


def cases() -> dict[str, Case]:
    exponential = Joint([Exponential()] * 10)
    one, five = Joint([LogNormal(0.0, 0.5)]), Joint([LogNormal(0.0, 0.5)] * 5)
    far, farther = 3.7190164854556804, 4.753424308822899
    # A lognormal law that has the mean and the variance of Exp(1).
    alike = Joint([LogNormal(-0.5 * math.log(2.0), math.sqrt(math.log(2.0)))] * 10)
    single = Joint([Exponential()])
    return {
        "lognormal, exact flow": Case(Product(1), 0.5 * far, one, one, normal.probability(-far)),
        "Exp(1), exact flow": Case(Total(1), math.log(1e4), single, single, 1e-4),
        "product of 5 lognormals, exact": Case(
            Product(5), 0.5 * math.sqrt(5.0) * farther, five, five, normal.probability(-farther)
        ),
        "sum of 10 Exp(1) >= 30, exact": Case(Total(10), 30.0, exponential, exponential, erlang(30.0, 10)),
        "sum >= 30, scale 10 % too large": Case(
            Total(10), 30.0, exponential, Stretched(exponential, 1.1), erlang(30.0, 10)
        ),
        "sum >= 30, scale 10 % too small": Case(
            Total(10), 30.0, exponential, Stretched(exponential, 0.9), erlang(30.0, 10)
        ),
        "sum >= 30, lognormal for Exp": Case(Total(10), 30.0, exponential, alike, erlang(30.0, 10)),
    }


def _maker(case: Case, weights: str) -> Callable[[], tuple[avrare.Problem, float]]:
    return lambda: (case.problem(weights), case.truth)


CASES = {
    f"{name}: {weights}": _maker(case, weights)
    for name, case in cases().items()
    for weights in ("none", "paper", "importance")
}
"""Problems and their probabilities by name."""


def learned(samples: int) -> None:
    from avrare_flows.train import fit

    kinds = (("affine_coupling", 2, 10.0, 3000), ("spline_autoregressive", 2, 10.0, 1000))
    print("| noise | flow | held out, exact, normal [nat] | CPU | none | P/q | health |")
    print("|---" * 7 + "|")
    for kind, size, level, steps in (*kinds, ("affine_coupling", 10, 30.0, 3000)):
        rows = np.random.default_rng(0).exponential(size=(samples, size))
        began = time.process_time()
        found = fit(rows, kind, steps=steps)
        spent = time.process_time() - began
        case = Case(Total(size), level, Joint([Exponential()] * size), found.flow, erlang(level, size))
        cells, health = [], set()
        for weights in ("none", "importance"):
            result = avrare.estimate(case.problem(weights), "ess", seed=1, runs=RUNS, chains=100)
            low, high = (end / case.truth for end in result.interval)
            cells.append(f"{result.probability / case.truth:.2f} [{low:.2f}, {high:.2f}]")
            health |= set(result.health)
        fitted = f"{found.held_out:.2f}, {-size:.2f}, {found.normal:.2f}"
        print(
            f"| {size} Exp(1), sum >= {level:g}, {case.truth:.2e} | {kind} | {fitted} | {spent:.0f} s", end=""
        )
        print(f" | {cells[0]} | {cells[1]} | {', '.join(sorted(health))} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("samples", type=int, nargs="?", default=20_000)
    learned(parser.parse_args().samples)
