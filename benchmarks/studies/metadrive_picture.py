"""One failing run from above, and the speeds of all of them beside a run without noise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare_metadrive.config import DT, SIGNALS, NoiseConfig
from avrare_metadrive.world import MetaDriveWorld

BEFORE = (30, 20, 10, 0)
"""Steps before the end that are drawn."""
Run = dict[str, NDArray[np.float64]]


def draw(simulator: Any, driver: Any, tapes: NDArray[np.float64], folder: Path) -> None:
    """Write ``failure.png`` (the first of ``tapes``, top views) and ``runs.png`` (curves of all).

    Args:
        simulator: Of the scenario.
        driver: Of the scenario.
        tapes: (F, steps + 1, noise_size) of failing runs.
        folder: Where to.
    """
    config = simulator.settings[0]().config
    quiet = MetaDriveWorld(config.model_copy(update={"noise": NoiseConfig()}))
    calm, _ = drive(quiet, driver, np.zeros((tapes.shape[1], 0)))
    runs = [drive(MetaDriveWorld(config), driver, tape)[0] for tape in tapes]
    for run in runs:
        ends = ", ".join(name for name in ("arrived", "crashed", "off_road") if run[name][-1])
        end, slowest = DT * (len(run["speed"]) - 1), run["speed"][30:].min()
        print(f"{end:.1f} s: {ends or 'under way'}; {slowest:.1f} m/s at least")
    last = len(runs[0]["speed"]) - 1
    _, pictures = drive(MetaDriveWorld(config), driver, tapes[0], [last - k for k in BEFORE])
    folder.mkdir(parents=True, exist_ok=True)
    _top_views(runs[0], pictures, folder / "failure.png")
    _curves(calm, runs, folder / "runs.png")


def drive(
    world: Any, driver: Any, tape: NDArray[np.float64], drawn: list[int] | None = None
) -> tuple[Run, dict[int, Any]]:
    """Signals (T,) until the world is over or the tape ends, and pictures of the steps in ``drawn``."""
    world.reset(tape[0])
    rows, pictures = [world.numbers()[: len(SIGNALS)]], {}
    for t, row in enumerate(tape[1:], start=1):
        action, _ = driver.act(None, world.observation()[None], None)
        world.step(action[0], row)
        rows.append(world.numbers()[: len(SIGNALS)])
        if drawn and t in drawn:
            pictures[t] = world.picture(900, 150, 9.0)
        if rows[-1][-1]:
            break
    return dict(zip(SIGNALS, np.array(rows).T, strict=True)), pictures


def _top_views(run: Run, pictures: dict[int, Any], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 1.75 * len(pictures)), layout="constrained")
    for axes, (t, picture) in zip(figure.subplots(len(pictures)), pictures.items(), strict=True):
        axes.imshow(picture)
        axes.set_axis_off()
        axes.set_title(f"{DT * t:.1f} s, {run['speed'][t]:.1f} m/s", fontsize=9, loc="left")
    figure.savefig(path, dpi=90)


def _curves(calm: Run, runs: list[Run], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    labels = {"speed": "speed [m/s]", "nearest": "nearest reading, true [m]"}
    for axes, (name, label) in zip(figure.subplots(1, 2), labels.items(), strict=True):
        for k, run in enumerate(runs):
            time = DT * np.arange(len(run[name]))
            axes.plot(time, run[name], color="tab:red", alpha=0.6, lw=0.9, label=None if k else "failing")
            axes.plot(time[-1], run[name][-1], "x", color="tab:red", ms=5)
        axes.plot(DT * np.arange(len(calm[name])), calm[name], color="black", lw=1.2, label="without noise")
        axes.set_xlabel("time [s]")
        axes.set_ylabel(label)
    axes.set_yscale("log")
    axes.set_yticks([2, 3, 5, 10, 20, 40], labels=["2", "3", "5", "10", "20", "40"])
    axes.minorticks_off()
    axes.legend(frameon=False)
    figure.savefig(path, dpi=90)
