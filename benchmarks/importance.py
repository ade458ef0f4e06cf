"""Does importance sampling say so where it breaks? Families b (d = 100), d and e, and easy problems.

    OMP_NUM_THREADS=1 python benchmarks/importance.py [SEEDS [FIRST]]     # about ten minutes for 40 seeds

Hard: cross-entropy, and proposals that are wrong in the ways that occur: one of many design points, another
scale, half the shift. A miss is a result whose *sample* is off by more than a factor 3: by its estimate, or
by the log-normal interval of its weights, which is what would be printed if warnings did not widen it. The
share of misses that carry a warning should be at least 0.95. Easy: good proposals, where the coverage should
be near 0.95 and warnings rare.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

import avrare

B = {1e-4: 3.7190164854556804, 1e-6: 4.753424308822899, 1e-9: 5.9978070150076865}
D = {2.5: 1.0618888379037e-2, 3.8: 1.1654634848511e-4, 4.8: 1.2225926292977e-6, 5.9: 2.6739869511e-9}
E = {4.0: 1.6780051045810e-3, 5.0: 1.7964133614712e-5, 6.0: 6.832111019271e-8}


@dataclass
class Static:
    """A limit state of one row of noise; failure at 0 and below."""

    noise_size: int
    state: Callable[[Any], Any]

    def initial(self, noise: Any) -> Any:
        """Evaluate it."""
        return {"g": self.state(noise)}

    def step(self, state: Any, noise: Any) -> Any:
        """Nothing happens."""
        return state

    def signals(self, state: Any) -> Any:
        """Its value."""
        return state


@dataclass
class Linear:
    """x <- a x + s w, 100 steps."""

    a: float
    s: float
    noise_size: int = 1

    def initial(self, noise: Any) -> Any:
        """At zero."""
        return {"x": np.zeros(len(noise))}

    def step(self, state: Any, noise: Any) -> Any:
        """One step."""
        return {"x": self.a * state["x"] + self.s * noise[:, 0]}

    def signals(self, state: Any) -> Any:
        """The position."""
        return state


@dataclass
class Normal:
    """Noise with another mean and scale."""

    mean: Any
    scale: float = 1.0

    def sample(self, rng: Any, n: int) -> Any:
        """Tapes."""
        return self.mean + self.scale * rng.standard_normal((n, *self.mean.shape))

    def log_ratio(self, noise: Any) -> Any:
        """Logarithm of p/q."""
        standard = (noise - self.mean) / self.scale
        size = 0.5 * (standard**2 - noise**2).reshape(len(noise), -1).sum(axis=1)
        return size + self.mean.size * np.log(self.scale)


def static(dimension: int, state: Callable[[Any], Any]) -> avrare.Problem:
    return avrare.Problem(Static(dimension, state), avrare.stl("always (g > 0)"), 0)


def sum_below(b: float) -> avrare.Problem:
    return static(100, lambda u: b - u.sum(axis=1) / 10.0)


def crosses(system: Linear, limit: float) -> avrare.Problem:
    return avrare.Problem(system, avrare.stl(f"always (x < {limit})"), 100)


def corners(beta: float) -> avrare.Problem:
    return static(2, lambda u: -(np.minimum(abs(u[:, 0]), u[:, 1]) + beta))


def four_branches(k: float) -> avrare.Problem:
    def state(u: Any) -> Any:
        total, difference = (u[:, 0] + u[:, 1]) / np.sqrt(2.0), u[:, 0] - u[:, 1]
        bend, side = 3.0 + 0.1 * difference**2, k / np.sqrt(2.0)
        return np.min([bend - total, bend + total, difference + side, side - difference], axis=0)

    return static(2, state)


def design_point(system: Linear, limit: float, at: int) -> Any:
    """The likeliest noise that brings x to ``limit`` at step ``at``."""
    reach = np.array([system.s * system.a ** (at - s) if s <= at else 0.0 for s in range(1, 101)])
    tape = np.zeros((101, 1))
    tape[1:, 0] = reach * limit / (reach @ reach)
    return tape


WALK, OU = Linear(1.0, 0.1), Linear(0.9, float(np.sqrt(0.19)))
Case = tuple[str, avrare.Problem, float, str, dict[str, Any]]


def hard() -> list[Case]:
    cases: list[Case] = []
    for p, b in B.items():
        flat, rough = np.full((1, 100), b / 10), np.random.default_rng(0).standard_normal((1, 100))
        laws = [Normal(flat, 1.3), Normal(flat, 0.8), Normal(0.5 * flat), Normal(flat + 0.2 * rough)]
        cases += [(f"b {p:.0e}", sum_below(b), p, "is", {"proposal": law}) for law in laws]
        cases.append((f"b {p:.0e}", sum_below(b), p, "ce", {}))
    for limit, p in D.items():
        laws = [Normal(design_point(WALK, limit, 50)), Normal(0.5 * design_point(WALK, limit, 100), 1.1)]
        cases += [(f"d {p:.0e}", crosses(WALK, limit), p, "is", {"proposal": law}) for law in laws]
        cases.append((f"d {p:.0e}", crosses(WALK, limit), p, "ce", {}))
    for limit, p in E.items():
        laws = [Normal(design_point(OU, limit, at)) for at in (100, 60, 30)]
        cases += [(f"e {p:.0e}", crosses(OU, limit), p, "is", {"proposal": law}) for law in laws]
        cases += [(f"e {p:.0e}", crosses(OU, limit), p, "ce", {"components": k}) for k in (1, 5)]
    return cases


def easy() -> list[Case]:
    cases: list[Case] = [
        ("a 1e-03", corners(-2.0), 1.0351370073191286e-3, "ce", {}),
        ("a 1e-03", corners(-2.0), 1.0351370073191286e-3, "ce", {"components": 2}),
        ("c 2e-03", four_branches(7.0), 2.2227950661944e-3, "ce", {}),
        ("d 1e-02", crosses(WALK, 2.5), D[2.5], "ce", {}),
        ("b 1e-04", sum_below(B[1e-4]), 1e-4, "ce", {}),
    ]
    shift = {"proposal": Normal(np.full((1, 100), B[1e-4] / 10))}
    walk = {"proposal": Normal(design_point(WALK, 2.5, 100))}
    return [
        *cases,
        ("b 1e-04", sum_below(B[1e-4]), 1e-4, "is", shift),
        ("d 1e-02", crosses(WALK, 2.5), D[2.5], "is", walk),
    ]


@dataclass(frozen=True)
class Misses:
    """Results off by more than a factor 3, and those of them without a warning."""

    estimates: int
    estimates_unwarned: int
    samples: int
    samples_unwarned: int

    def __add__(self, other: Misses) -> Misses:
        return Misses(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def __str__(self) -> str:
        return (
            f"estimates off by more than a factor 3: {self.estimates}, "
            f"of them warned {1 - self.estimates_unwarned / max(self.estimates, 1):.4f}; "
            f"intervals of the weights that miss by more than a factor 3: {self.samples}, "
            f"of them warned {1 - self.samples_unwarned / max(self.samples, 1):.4f}"
        )


def interval_of_weights(result: avrare.Result) -> tuple[float, float]:
    """The log-normal interval of the weighted mean, which no warning has widened; (0, 0) for the mean 0."""
    if result.probability == 0.0 or not np.isfinite(result.relative_error):
        return 0.0, 0.0
    half = 1.959964 * np.sqrt(np.log1p(result.relative_error**2))
    return result.probability * np.exp(-half), result.probability * np.exp(half)


def measure(case: Case, seeds: range, rollouts: int) -> Misses:
    """Print a line about a case; its misses."""
    name, problem, p, estimator, options = case
    results = [avrare.estimate(problem, estimator, seed=seed, rollouts=rollouts, **options) for seed in seeds]
    values = np.array([result.probability for result in results]) / p
    off = (values < 1 / 3) | (values > 3)
    warned = np.array([bool(result.health) for result in results])
    sample = far_off(np.array([interval_of_weights(result) for result in results]) / p)
    bounds = np.array([result.interval for result in results]) / p
    far = far_off(bounds)
    covered = ((bounds[:, 0] <= 1) & (bounds[:, 1] >= 1)).mean()
    names = Counter(name for result in results for name in result.health)
    print(
        f"{name} {estimator}  mean/true {values.mean():.3f} +- {values.std() / np.sqrt(len(seeds)):.3f}"
        f"  off {off.mean():.2f} (unwarned {(off & ~warned).sum()})  weights' interval off"
        f" {sample.mean():.2f} (unwarned {(sample & ~warned).sum()})  printed interval off {far.mean():.2f}"
        f" (unwarned {(far & ~warned).sum()})  warned {warned.mean():.2f}  coverage {covered:.3f}"
        f"  {dict(names)}",
        flush=True,
    )
    counts = (off, off & ~warned, sample, sample & ~warned)
    return Misses(*(int(which.sum()) for which in counts))


def far_off(ratios: Any) -> Any:
    """Which intervals over the truth, (N, 2), miss 1 by more than a factor 3."""
    return (ratios[:, 0] > 3) | (ratios[:, 1] < 1 / 3)


def main(count: int, first: int) -> None:
    """Hard and easy cases at ``count`` seeds from ``first``."""
    seeds = range(first, first + count)
    for rollouts in (1000, 2000):
        print(f"hard, {rollouts} rollouts a stage")
        print(sum((measure(case, seeds, rollouts) for case in hard()), Misses(0, 0, 0, 0)))
    print("easy, 1000 rollouts a stage")
    for case in easy():
        measure(case, range(first, first + 4 * count), 1000)


if __name__ == "__main__":
    given = [int(text) for text in sys.argv[1:]]
    main(given[0] if given else 40, given[1] if len(given) > 1 else 0)
