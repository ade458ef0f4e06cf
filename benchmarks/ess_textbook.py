"""Subset simulation as the textbooks have it, apart from the library: its relative MSE x evaluations.

    OMP_NUM_THREADS=1 nice python benchmarks/ess_textbook.py [RUNS] [others]

N = 2000 samples a level, p0 = 0.1, every survivor seeds a chain of ten, levels are order statistics; chains
move by elliptical slices with a shrinking bracket, or by pCN with rho = 0.8. For each case the product of
3,000 runs (or RUNS) with its standard error, and what 100 runs would have shown, 95 times of 100. For
docs/slice-sampling.md, which compares the library with these. About four CPU minutes. ``others``: the
same for other numbers of samples, shares, brackets and step lengths.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.testing.problems import reference_problem

Floats = NDArray[np.float64]
BLOCK = 100
"""Runs that advance together."""


@dataclass(frozen=True)
class Case:
    """A problem in the plane: it fails where ``score`` (..., 2) -> (...) is 0 or more."""

    problem: str
    score: Callable[[Floats], Floats]


@dataclass(frozen=True)
class Setting:
    """Setting of the runs: kernel, N, p0, and what the kernel needs."""

    kernel: str
    samples: int = 2000
    share: float = 0.1
    rho: float = 0.8
    width: float = 2.0 * np.pi

    @property
    def chains(self) -> int:
        """C, of a run."""
        return round(self.samples * self.share)


def corners(beta: float) -> Callable[[Floats], Floats]:
    """Return the score of family a."""
    return lambda u: np.asarray(np.minimum(np.abs(u[..., 0]), u[..., 1]) + beta)


def four_branch(u: Floats) -> Floats:
    """Return the score of family c, k = 7."""
    a, b, root = u[..., 0], u[..., 1], np.sqrt(2.0)
    bowl = 3.0 + 0.1 * (a - b) ** 2
    score: Floats = -np.minimum(
        np.minimum(bowl - (a + b) / root, bowl + (a + b) / root), 7.0 / root - np.abs(a - b)
    )
    return score


CASES = (
    Case("a_beta_-2", corners(-2.0)), Case("a_beta_-2.5", corners(-2.5)), Case("a_beta_-3", corners(-3.0)),
    Case("c_fourbranch_k7", four_branch),
)  # fmt: skip
BASE = (Setting("shrink"), Setting("pcn"))
OTHERS = (
    *(Setting("shrink", share=share) for share in (0.02, 0.05, 0.2, 0.25)), Setting("shrink", 4000, 0.05),
    *(Setting("shrink", width=width) for width in (1.0, 2.0, 3.0, 4.5)),
    *(Setting("pcn", rho=rho) for rho in (0.9, 0.7, 0.6)),
)  # fmt: skip


class Chains:
    """M chains of ``owner`` runs, kept above ``level``; counts evaluations run by run."""

    def __init__(self, case: Case, setting: Setting, rng: np.random.Generator, cost: Floats) -> None:
        self.case, self.setting, self.rng, self.cost = case, setting, rng, cost

    def scored(self, x: Floats, owner: NDArray[np.int64]) -> Floats:
        """Return scores, paid for."""
        np.add.at(self.cost, owner, 1.0)
        return self.case.score(x)

    def pcn(self, x: Floats, level: Floats, owner: NDArray[np.int64]) -> Floats:
        """Take one step with a fixed rho."""
        rho = self.setting.rho
        new = rho * x + np.sqrt(1.0 - rho**2) * self.rng.standard_normal(x.shape)
        return np.where((self.scored(new, owner) > level)[:, None], new, x)

    def shrink(self, x: Floats, level: Floats, owner: NDArray[np.int64]) -> Floats:
        """Take one step of Murray, Adams and MacKay (2010); a narrower bracket lies about 0 at random."""
        width = self.setting.width
        other, end, wait = self.rng.standard_normal(x.shape), x.copy(), np.arange(len(x))
        angle = width * self.rng.uniform(size=len(x))
        high = angle.copy()
        if width < 2.0 * np.pi:
            high = width * self.rng.uniform(size=len(x))
            angle += high - width
        low = high - width
        while len(wait):
            cosine, sine = np.cos(angle[wait])[:, None], np.sin(angle[wait])[:, None]
            new = x[wait] * cosine + other[wait] * sine
            good = self.scored(new, owner[wait]) > level[wait]
            end[wait[good]], wait = new[good], wait[~good]
            back = angle[wait] < 0.0
            low[wait[back]], high[wait[~back]] = angle[wait[back]], angle[wait[~back]]
            angle[wait] = self.rng.uniform(low[wait], high[wait])
        return end


def block(case: Case, setting: Setting, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return estimates and evaluations (BLOCK,) of as many runs."""
    many, seeding = setting.samples, setting.chains
    found, weight, cost = np.zeros(BLOCK), np.ones(BLOCK), np.full(BLOCK, float(many))
    step, live = getattr(Chains(case, setting, rng, cost), setting.kernel), np.arange(BLOCK)
    x = rng.standard_normal((BLOCK, many, 2))
    while True:
        score = case.score(x)  # known: nobody pays twice
        order = np.argsort(score, axis=1)
        level = np.take_along_axis(score, order, axis=1)[:, many - seeding - 1]
        done = level >= 0.0
        found[live[done]] = weight[live[done]] * (score[done] >= 0.0).mean(axis=1)
        x, order, level, live = x[~done], order[~done], level[~done], live[~done]
        if not len(live):
            return found, cost
        weight[live] *= setting.share
        seeds = np.take_along_axis(x, order[:, many - seeding :, None], axis=1).reshape(-1, 2)
        owner, level = np.repeat(live, seeding), np.repeat(level, seeding)
        samples = [seeds]
        for _ in range(many // seeding - 1):
            samples.append(step(samples[-1], level, owner))
        x = np.stack(samples).reshape(-1, len(live), seeding, 2).transpose(1, 0, 2, 3).reshape(-1, many, 2)


def line(case: Case, setting: Setting, runs: int) -> str:
    """Format the outcome of ``runs`` runs."""
    rng = np.random.default_rng([5, *f"{case.problem}{setting}".encode()])
    parts = [block(case, setting, rng) for _ in range(-(-runs // BLOCK))]
    ratio = np.concatenate([part[0] for part in parts]) / reference_problem(case.problem).probability
    cost, square = np.concatenate([part[1] for part in parts]).mean(), (ratio - 1.0) ** 2
    low, high = np.percentile([rng.choice(square, 100).mean() * cost for _ in range(5000)], [2.5, 97.5])
    error = square.std() / np.sqrt(len(square)) * cost
    return (
        f"{case.problem:15s} {setting}  mean/p {ratio.mean():.3f}  evaluations {cost:,.0f}  "
        f"product {square.mean() * cost:,.0f} +- {error:,.0f}  of 100 runs {low:,.0f} .. {high:,.0f}"
    )


def main(runs: int, others: bool) -> None:
    """Print a line a case and setting."""
    for case in CASES[2:] if others else CASES:
        for setting in OTHERS if others else BASE:
            print(line(case, setting, runs), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3000, "others" in sys.argv[2:])
