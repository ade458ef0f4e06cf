"""Do importance sampling and cross-entropy say so where they miss a mode? Problems that nothing was tuned on.

    OMP_NUM_THREADS=1 python -m benchmarks.importance [--seeds 100] [--first 0] [--problems NAME,...]

Default options. CW is the share of results without a warning whose
interval misses the truth by more than a factor 3. ``check`` is the cross-check's share of the rollouts. The
proposals of ``is`` shift the linear mode alone, or all modes.
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

import avrare
from benchmarks.studies.untuned_problems import Modes, Untuned, untuned_problems

CE = (
    "static_late", "static_rare_1e-3", "static_rare_1e-4", "late", "late_ou", "units_three", "static_units",
    "flat", "static_flat", "misleading", "outlier_walk", "unequal", "unequal_four", "static_unequal",
    "static_unequal_10", "plain_walk", "plain_ou", "static_plain_50",
)  # fmt: skip
IS = ("static_late", "static_rare_1e-4", "static_unequal", "static_units")


@dataclass(frozen=True)
class Equal:
    """Mixture of shifted normals of a static tape, equally likely.

    Attributes:
        means: (K, noise_size).
    """

    means: Any

    def sample(self, rng: Any, n: int) -> Any:
        """Draw tapes."""
        chosen = rng.integers(len(self.means), size=n)
        return (self.means[chosen] + rng.standard_normal((n, self.means.shape[1])))[:, None]

    def log_ratio(self, noise: Any) -> Any:
        """Return log p/q."""
        logs = noise[:, 0] @ self.means.T - 0.5 * (self.means**2).sum(axis=1)
        return -np.logaddexp.reduce(logs, axis=1) + np.log(len(self.means))


def first_mode(problem: Untuned, every: bool) -> Equal:
    """Return the shift to the first mode, or the mixture of the shifts to all."""
    assert isinstance(problem.system, Modes)
    means = np.diag(problem.system.levels / problem.system.scale)
    return Equal(means if every else means[:1])


def measure(problem: Untuned, estimator: str, seeds: range, note: str = "", **options: Any) -> None:
    """Print a line about a problem."""
    results = [avrare.estimate(problem.problem(), estimator, seed=seed, **options) for seed in seeds]
    p = problem.probability
    values = np.array([result.probability for result in results]) / p
    low, high = np.array([result.interval for result in results]).T / p
    covers = (low <= 1.0) & (high >= 1.0)
    far = (low > 3.0) | (high < 1.0 / 3.0)
    warned = np.array([bool(result.health) for result in results])
    quiet = f"{covers[~warned].mean():.3f}" if (~warned).any() else "-"
    rollouts = np.mean([result.rollouts for result in results])
    checks = np.mean([result.diagnostics.get("check_rollouts", 0) for result in results]) / rollouts
    names = Counter(name for result in results for name in result.health)
    print(
        f"{problem.name:18s} {estimator} {note:6s} mean {values.mean():.2f} median {np.median(values):.2f}"
        f" covers {covers.mean():.3f} warned {warned.mean():.3f} covers unwarned {quiet} CW"
        f" {(far & ~warned).mean():.3f} width {np.median(high / low):.3g} rollouts {rollouts:.0f} check"
        f" {checks:.3f} {dict(names)}",
        flush=True,
    )


def main() -> None:
    """Measure the problems that were asked for."""
    warnings.simplefilter("ignore", avrare.HealthWarning)
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--problems", default=",".join(CE))
    given = parser.parse_args()
    seeds, problems = range(given.first, given.first + given.seeds), untuned_problems()
    names = given.problems.split(",")
    for name in names:
        measure(problems[name], "ce", seeds)
    for name in (name for name in IS if name in names):
        for every in (False, True):
            proposal = first_mode(problems[name], every)
            measure(problems[name], "is", seeds, "all" if every else "first", proposal=proposal)


if __name__ == "__main__":
    main()
