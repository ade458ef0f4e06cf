"""The perching glider (stl-ess, section VI-C): why it misses the wire. Fig. 12 and 13.

OMP_NUM_THREADS=1 nice python benchmarks/glider.py docs/glider
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from studies.figures import BLUE, GREY, ORANGE, RED, make_axes
from studies.recorded_levels import RecordedLevels

import avrare
from avrare.estimation.loop.loop import run as estimate_with
from avrare.estimation.plan.plan import Settings
from avrare.protocols import Floats
from avrare.rollout.executors.serial import SerialExecutor
from avrare_estimators.common.chains.pcn import PcnKernel
from avrare_estimators.ess.config import NestedLevelsConfig
from avrare_glider.nominal import nominal

ROOT = Path(__file__).parents[1]
TAPES = 50_000


@dataclass(frozen=True)
class Flights:
    """Flights of Monte Carlo.

    Attributes:
        tapes: (N, steps + 1, noise_size).
        x: (N, steps + 1) [m].
        z: (N, steps + 1) [m].
    """

    tapes: Floats
    x: Floats
    z: Floats

    @property
    def fails(self) -> Any:
        """(N,) which of them miss the wire."""
        return (np.abs(self.x) + np.abs(self.z)).min(axis=1) > 0.05

    @property
    def above(self) -> Any:
        """(N,) which of them are above the wire where they are next to it."""
        nearest = (np.abs(self.x) + np.abs(self.z)).argmin(axis=1)
        return self.z[np.arange(len(self.z)), nearest] > 0.0


def problem_of(scenario: str) -> avrare.Problem:
    return avrare.load(ROOT / "scenarios" / f"{scenario}.yaml").problem("perches")


def fly(problem: avrare.Problem, tapes: Floats) -> Flights:
    """Drive the tapes, a few thousand at a time."""
    xs, zs = [], []
    for part in np.array_split(tapes, max(1, len(tapes) // 5000)):
        state = problem.system.initial(part[:, 0])
        seen = [problem.system.signals(state)]
        for t in range(1, part.shape[1]):
            state = problem.system.step(state, part[:, t])
            seen.append(problem.system.signals(state))
        xs.append(np.stack([s["x"] for s in seen], axis=1))
        zs.append(np.stack([s["z"] for s in seen], axis=1))
    return Flights(tapes, np.concatenate(xs), np.concatenate(zs))


def monte_carlo(scenario: str) -> Flights:
    problem = problem_of(scenario)
    shape = TAPES, problem.steps + 1, problem.noise_size
    return fly(problem, np.random.default_rng(12).standard_normal(shape))


def pictures(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    start, actuator = monte_carlo("glider"), monte_carlo("glider_actuator")
    flights(start, actuator, folder / "flights.png")
    starts(start, folder / "starts.png")
    reasons(actuator, folder / "reasons.png")
    cures(actuator, folder / "cures.png")


def flights(start: Flights, actuator: Flights, picture: Path) -> None:
    """Draw all the way, and the last metre for both kinds of noise."""
    figure, (whole, *near) = make_axes(12.0, 3.4, 3, widths=(2.2, 1.0, 1.0))
    path = nominal().states
    whole.plot(path[:, 0], path[:, 1], color=BLUE, lw=1.6)
    for x, z, pitch, elevator in path[::11, :4]:
        _plane(whole, x, z, pitch, elevator)
    whole.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", ylim=(-0.75, 0.6), title="nominal flight")
    for ax, some, title in zip(near, (start, actuator), ("random start", "noisy elevator"), strict=True):
        _paths(ax, some, np.flatnonzero(~some.fails)[:60], GREY, 0.5)
        _paths(ax, some, np.flatnonzero(some.fails & some.above)[:25], RED, 0.8)
        _paths(ax, some, np.flatnonzero(some.fails & ~some.above)[:25], ORANGE, 0.8)
        ax.plot([0.05, 0, -0.05, 0, 0.05], [0, 0.05, 0, -0.05, 0], color="black", lw=1.4)
        ax.set(xlim=(-0.42, 0.1), ylim=(-0.2, 0.2), xlabel="x [m]", title=title)
    figure.savefig(picture, dpi=110)


def _paths(ax: Axes, some: Flights, rows: Any, colour: str, width: float) -> None:
    ax.plot(some.x[rows].T, some.z[rows].T, color=colour, lw=width, alpha=0.7)


def _plane(ax: Axes, x: float, z: float, pitch: float, elevator: float) -> None:
    """Draw fuselage and elevator, to scale but for the elevator, which is drawn longer."""
    hinge = x - 0.27 * np.cos(pitch), z - 0.27 * np.sin(pitch)
    ax.plot([x + 0.1 * np.cos(pitch), hinge[0]], [z + 0.1 * np.sin(pitch), hinge[1]], color="black", lw=1.8)
    angle = pitch + elevator
    end = hinge[0] - 0.1 * np.cos(angle), hinge[1] - 0.1 * np.sin(angle)
    ax.plot([hinge[0], end[0]], [hinge[1], end[1]], color=RED, lw=1.8)


def starts(sample: Flights, picture: Path) -> None:
    """Draw Fig. 12: where failing flights start, by nested levels and by Monte Carlo."""
    problem = problem_of("glider")
    recorder = RecordedLevels(NestedLevelsConfig(chains=300, runs=1, second_pass=False), PcnKernel())
    recorder.tapes = []
    from_levels = _levels_of(problem, recorder)
    figure, axes = make_axes(9.0, 4.0, 2)
    for shade, tape in zip(np.linspace(0.85, 0.45, len(from_levels)), from_levels, strict=True):
        axes[0].plot(*_start(tape).T, ".", color=str(shade), markersize=2.5)
    failing = np.concatenate([tape[fly(problem, tape).fails] for tape in from_levels])
    axes[0].plot(*_start(failing).T, ".", color="black", markersize=3.0)
    axes[0].set_title(f"ess, {len(from_levels)} levels, {sum(map(len, from_levels)):,} samples", fontsize=10)
    axes[1].plot(*_start(sample.tapes[:8880]).T, ".", color=GREY, markersize=2.0)
    lost = sample.tapes[:8880][sample.fails[:8880]]
    axes[1].plot(*_start(lost).T, ".", color="black", markersize=3.0)
    axes[1].set_title(f"Monte Carlo, 8,880 samples, {len(lost)} fail", fontsize=10)
    for ax in axes:
        ax.set(xlim=(-4.6, 4.6), ylim=(-4.6, 4.6), xlabel="x at the start [sigma]")
    axes[0].set_ylabel("z at the start [sigma]")
    figure.savefig(picture, dpi=110)


def _levels_of(problem: avrare.Problem, recorder: RecordedLevels) -> list[Floats]:
    estimate_with(problem, recorder, SerialExecutor(), Settings(seed=4))
    return recorder.tapes


def _start(tapes: Floats) -> Floats:
    return tapes[:, 0, :2]


def reasons(sample: Flights, picture: Path) -> None:
    """Draw Fig. 13 (a): the mean noise of failing flights, and where they lie along it."""
    figure, (left, right) = make_axes(10.0, 4.0, 2)
    tapes, t = sample.tapes[:, 1:, 0], 0.01 * np.arange(sample.tapes.shape[1] - 1)
    lost = tapes[sample.fails]
    mean, error = lost.mean(axis=0), lost.std(axis=0) / np.sqrt(len(lost))
    left.plot(t, lost.T, color=GREY, lw=0.4, alpha=0.5)
    left.fill_between(t, mean - 2 * error, mean + 2 * error, color=RED, alpha=0.25, lw=0)
    left.plot(t, mean, color=RED, lw=1.6, label=f"mean of {len(lost)}, with two standard errors")
    peak = np.abs(mean).argmax()
    print(f"{len(lost)} fail, they end at x = {sample.x[sample.fails, -1].max():.3f} m or before; ", end="")
    print(f"mean noise largest at {t[peak]:.2f} s: {mean[peak]:+.2f} sigma")
    left.axhline(0.0, color="black", lw=0.6)
    left.set(xlabel="time [s]", ylabel="noise of the elevator's rate [sigma]")
    left.legend(frameon=False, fontsize=9)
    first = mean / np.linalg.norm(mean)
    rest = lost - np.outer(lost @ first, first)
    second = np.linalg.svd(rest - rest.mean(axis=0), full_matrices=False)[2][0]
    for some, colour, size in ((~sample.fails, GREY, 1.0), (sample.fails, "black", 5.0)):
        rows = tapes[some][:8000]
        right.plot(rows @ first, rows @ second, ".", color=colour, markersize=size)
    low, high = (lost @ first).min(), (lost @ first).mean()
    print(f"along their mean: from {low:.2f} sigma, {high:.2f} in the mean")
    right.set(
        xlabel="along the mean of what fails [sigma]", ylabel="along what varies most beside it [sigma]"
    )
    figure.savefig(picture, dpi=110)


def cures(sample: Flights, picture: Path) -> None:
    """Draw Fig. 13 (b): which failing flights would perch if the noise of one moment had the other sign."""
    problem, lost = problem_of("glider_actuator"), sample.tapes[sample.fails]
    steps = lost.shape[1] - 1
    turned = np.repeat(lost[:, None], steps, axis=1)
    turned[:, np.arange(steps), 1 + np.arange(steps)] *= -1.0
    cured = ~fly(problem, turned.reshape(-1, *lost.shape[1:])).fails.reshape(-1, steps)
    figure, (ax,) = make_axes(6.4, 3.4)
    ax.bar(0.01 * np.arange(steps), cured.mean(axis=0), width=0.009, color=BLUE)
    ax.set(xlabel="time of the step whose noise is turned [s]", ylabel="share that perches then")
    figure.savefig(picture, dpi=110)
    best = cured.mean(axis=0).argmax()
    print(f"turning one step saves most at {0.01 * best:.2f} s: {cured[:, best].mean():.0%}; ", end="")
    print(f"some step saves {cured.any(axis=1).mean():.0%} of {len(lost)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, help="where the pictures go")
    pictures(parser.parse_args().folder)
