"""A Gaussian point in the plane that must not hit corners (stl-ess, section VI-A): Fig. 6, 7 and 8.

    OMP_NUM_THREADS=1 nice python benchmarks/case_gaussian.py levels FIG6.png
    OMP_NUM_THREADS=1 nice python benchmarks/case_gaussian.py betas OUT.json FIG7.png
    OMP_NUM_THREADS=1 nice python benchmarks/case_gaussian.py squares FIG8.png
    OMP_NUM_THREADS=1 nice python benchmarks/case_gaussian.py spread
    python benchmarks/case_gaussian.py bounds FIG5.png

``betas`` keeps what it has estimated in OUT.json and only draws where that is there. ``spread``
compares the variance of runs with what Eq. 21 says of each; ``bounds`` draws Eq. 28 and its counterpart.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from studies.error_analysis import overestimate_bound, relative_variance, underestimate_bound
from studies.figures import BLUE, GREY, ORANGE, RED, make_axes
from studies.recorded_levels import RecordedLevels

import avrare
from avrare.estimation.loop.loop import run as estimate_with
from avrare.estimation.plan.plan import Settings
from avrare.rollout.executors.serial import SerialExecutor
from avrare.testing import normal
from avrare_estimators.common.chains.pcn import PcnKernel
from avrare_estimators.ess.config import NestedLevelsConfig
from avrare_linear.simulator import system_of
from avrare_linear.synthesis import Effort, synthesise

SCENARIOS = Path(__file__).parents[1] / "scenarios"
REPETITIONS = 10
BETAS = np.linspace(-3.0, -2.0, 11)


def corner_problem(beta: float) -> avrare.Problem:
    b = -beta
    formula = avrare.stl(f"not ((x >= {b} and y >= {b}) or (-x >= {b} and y >= {b}))")
    problem = avrare.load(SCENARIOS / "constrained_gaussian.yaml").problem("clear")
    return avrare.Problem(problem.system, formula, steps=0, chunk=1000)


def exact(beta: float) -> float:
    return 2.0 * normal.probability(beta) ** 2


def levels(picture: Path) -> None:
    problem = avrare.load(SCENARIOS / "constrained_gaussian.yaml").problem("clear")
    recorder = RecordedLevels(NestedLevelsConfig(chains=100, runs=1, level_probability=0.25), PcnKernel())
    (result,) = estimate_with(problem, recorder, SerialExecutor(), Settings(seed=4))
    figure, (ax,) = make_axes(6.0, 4.6)
    shades = np.linspace(0.82, 0.0, len(recorder.tapes))
    for shade, tape in zip(shades, recorder.tapes, strict=True):
        ax.plot(tape[:, 0, 0], tape[:, 0, 1], ".", color=str(shade), markersize=3.0)
    for side in (-1.0, 1.0):
        ax.plot([6.0 * side, 3.0 * side, 3.0 * side], [3.0, 3.0, 6.0], color=RED, lw=1.2)
    ax.set(xlim=(-5.2, 5.2), ylim=(-3.8, 5.2), xlabel="x", ylabel="y", aspect="equal")
    p = result.probability
    title = f"{len(recorder.tapes)} levels, darker: later; one run: p = {p:.2g} (exact {exact(-3):.2g})"
    ax.set_title(title, fontsize=10)
    figure.savefig(picture, dpi=110)
    print(f"{len(recorder.tapes)} levels, p = {p:.3g}, {result.rollouts} rollouts")


def estimates(beta: float) -> dict[str, Any]:
    """Make ten repetitions of each method; Monte Carlo has as many rollouts as nested levels have used."""
    problem = corner_problem(beta)
    options = {"runs": REPETITIONS, "chains": 50}
    seed = round(-100.0 * beta)
    linear = avrare.estimate(problem, "ess_linear", seed=seed, **options)
    nested = avrare.estimate(problem, "ess", seed=seed, **options)
    each = nested.rollouts // REPETITIONS
    plain = avrare.estimate(problem, "mc", seed=seed, rollouts=each, runs=REPETITIONS)
    found = {"ess_linear": linear, "ess": nested, "mc": plain}
    return {
        name: {"runs": list(one.run_probabilities), "rollouts": one.rollouts} for name, one in found.items()
    } | {"beta": beta}


def betas(store: Path, picture: Path) -> None:
    if not store.exists():
        store.write_text(json.dumps([estimates(float(beta)) for beta in BETAS]))
    rows = json.loads(store.read_text())
    figure, (ax,) = make_axes(7.0, 4.4)
    truth = np.array([exact(row["beta"]) for row in rows])
    names = {"mc": ("Monte Carlo", GREY), "ess": ("ess", ORANGE), "ess_linear": ("ess_linear", BLUE)}
    print("| beta | exact | " + " | ".join(f"{name}: mean, std / exact" for name in names) + " | rollouts |")
    print("|---" * 6 + "|")
    for name, (label, colour) in names.items():
        values = np.array([row[name]["runs"] for row in rows])
        mean, std = values.mean(axis=1), values.std(axis=1, ddof=1)
        at = [row["beta"] for row in rows]
        ax.plot(at, mean, color=colour, label=label, lw=1.6)
        ax.fill_between(at, np.maximum(mean - std, 1e-8), mean + std, color=colour, alpha=0.22, lw=0)
    ax.plot([row["beta"] for row in rows], truth, "k--", lw=1.2, label="exact")
    for row, p in zip(rows[::2], truth[::2], strict=True):
        cells = [np.array(row[name]["runs"]) / p for name in names]
        text = " | ".join(f"{cell.mean():.2f}, {cell.std(ddof=1):.2f}" for cell in cells)
        print(f"| {row['beta']:.1f} | {p:.3g} | {text} | {row['ess']['rollouts'] // REPETITIONS:,} |")
    ax.set(yscale="log", ylim=(5e-7, 3e-3), xlabel="beta", ylabel="probability of failure")
    ax.legend(loc="upper left", frameon=False)
    ax.set_title("ten repetitions: mean and one standard deviation", fontsize=10)
    figure.savefig(picture, dpi=110)


def squares(picture: Path) -> None:
    problem = avrare.load(SCENARIOS / "four_squares.yaml").problem("clear")
    formula: Any = problem.monitors[0].formula  # type: ignore[attr-defined]
    steps = synthesise(
        system_of(problem), formula, 0, "mean", rate=0.1, iterations=20, least=0.02, effort=Effort()
    )
    path = np.array([step.parameter[0] for step in steps])
    grid = np.linspace(-1.4, 1.4, 141)
    reach = normal.cdf(grid - 3.0) + normal.cdf(-grid - 3.0)
    figure, (ax,) = make_axes(6.2, 5.0)
    drawn = ax.contourf(grid, grid, np.log10(np.outer(reach, reach)), levels=14, cmap="Blues")
    figure.colorbar(drawn, ax=ax, label="log10 of the exact probability")
    ax.plot(path[:, 0], path[:, 1], "o-", color=ORANGE, lw=1.6, markersize=5.0)
    for i, (x, y) in enumerate(path):
        ax.annotate(str(i), (x, y), textcoords="offset points", xytext=(6, -10), color=ORANGE)
    ax.set(xlabel="mean of x", ylabel="mean of y", aspect="equal")
    figure.savefig(picture, dpi=110)
    for i, step in enumerate(steps):
        x, y = step.parameter[0]
        reached = [normal.probability(m - 3.0) + normal.probability(-m - 3.0) for m in (x, y)]
        print(f"{i}  ({x:6.3f}, {y:6.3f})  {step.probability:.3g}  exact {math.prod(reached):.3g}")


def spread() -> None:
    """Compare the true relative variance of 200 runs with what Eq. 21 says, for N and for effective sizes."""
    print("| beta | chains x length | skip | relative variance | over Eq. 21, N | over Eq. 21, effective |")
    print("|---" * 6 + "|")
    for beta in (-2.0, -3.0):
        for chains, share, skip in ((50, 0.1, 0), (50, 0.1, 3), (250, 0.5, 0), (25, 0.5, 3)):
            options = {"chains": chains, "level_probability": share, "skip": skip, "runs": 200}
            found = avrare.estimate(corner_problem(beta), "ess", seed=11, **options)
            told, alive = found.diagnostics, found.run_probabilities > 0.0
            ratio = found.run_probabilities / exact(beta)
            said = np.array([
                [relative_variance(shares, size) for size in (told["samples"], sizes)]
                for shares, sizes, lives in zip(told["shares"], told["effective_sizes"], alive, strict=True)
                if lives
            ])  # fmt: skip
            naive, effective = ratio.var(ddof=1) / said.mean(axis=0)
            length = told["samples"] // chains
            print(
                f"| {beta:g} | {chains} x {length} | {skip} | {ratio.var(ddof=1):.3f} | {naive:.2f} | "
                f"{effective:.2f} |"
            )


def bounds(picture: Path) -> None:
    figure, (ax,) = make_axes(7.0, 4.4)
    levels, samples = 10, np.unique(np.geomspace(20, 3000, 60).astype(int))
    for factor, colour in ((1.5, GREY), (2.0, BLUE), (2.5, ORANGE), (3.0, RED)):
        over = [overestimate_bound(factor, levels, int(n)) for n in samples]
        under = [underestimate_bound(factor, levels, int(n)) for n in samples]
        ax.plot(samples / levels, over, color=colour, lw=1.6, label=f"{factor:g} times too high")
        ax.plot(samples / levels, under, "--", color=colour, lw=1.6, label=f"{factor:g} times too low")
    ax.set(xscale="log", yscale="log", ylim=(1e-6, 1.3), xlabel="samples of a level / levels")
    ax.set_ylabel("bound on the probability")
    ax.set_title("independent samples, 10 fixed levels of share at least 1/2", fontsize=10)
    ax.legend(frameon=False, fontsize=8, ncols=1, loc="lower left")
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    commands = {"levels": levels, "betas": betas, "squares": squares, "spread": spread, "bounds": bounds}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("command", choices=commands)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE")
    args = parser.parse_args()
    commands[args.command](*args.files)
