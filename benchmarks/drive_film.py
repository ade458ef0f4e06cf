"""Film and picture of a failure of a run: vehicles as they are, and where the tracker believes them.

    python benchmarks/drive_film.py RUN RULE OUT [--failure 3]

Writes OUT.gif and OUT.png, which shows four moments; without --failure of the worst failure.
"""

from __future__ import annotations

import argparse
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D

import avrare
from avrare.results.run import Run

COLOURS = {"ego": "#1b6ca8", "parked": "#b0443c"}
BEHIND, AHEAD = 35.0, 145.0
"""What is shown of the road about the ego [m]."""
EVERY = 2
"""Samples from picture to picture."""


def drive(loop: Any, tape: Any) -> list[Any]:
    """Return the states of a drive until its impact or end."""
    states = [loop.initial(tape[None, 0])]
    for row in tape[1:]:
        if states[-1].world.ended[0]:
            break
        states.append(loop.step(states[-1], row[None]))
    return states


def draw_box(ax: Axes, place: tuple[float, ...], size: tuple[float, float], **style: Any) -> None:
    """Draw a vehicle at (x, y, heading)."""
    x, y, heading = place
    box = plt.Rectangle((-0.5 * size[0], -0.5 * size[1]), *size, **style)
    box.set_transform(Affine2D().rotate(heading).translate(x, y) + ax.transData)
    ax.add_patch(box)


def draw(ax: Axes, loop: Any, scene: Any, state: Any, time: float) -> None:
    """Draw one sample."""
    world, ego = state.world, state.world.ego
    ax.clear()
    road = scene.road
    low = min(road.lane_centres) - 0.5 * road.lane_width
    for k in range(len(road.lane_centres) + 1):
        ax.axhline(low + k * road.lane_width, color="0.6", lw=0.8, ls="-" if k in (0, 3) else (0, (8, 8)))
    track = loop.tracker.estimate(state.track)
    for k, name in enumerate(scene.names):
        colour, size = COLOURS.get(name, "0.35"), (scene.lengths[k], scene.widths[k])
        place = tuple(getattr(world.others, field)[0, k] for field in ("x", "y", "heading"))
        draw_box(ax, place, size, color=colour, alpha=0.75)
        ax.text(place[0], place[1] + 1.1, name, fontsize=7, ha="center", clip_on=True)
        if track.exists[0, k]:
            believed = track.x[0, k], track.y[0, k], 0.0
            draw_box(ax, believed, size, fill=False, ec=colour, lw=1.2, ls="--")
    ego_size = scene.ego_length, scene.ego_width
    draw_box(ax, (ego.x[0], ego.y[0], ego.heading[0]), ego_size, color=COLOURS["ego"])
    impact = "   impact" if world.ended[0] else ""
    ax.set_title(
        f"t = {time:.1f} s   ego {ego.speed[0]:.1f} m/s, {ego.acceleration[0]:+.1f} m/s$^2${impact}",
        fontsize=9, loc="left",
    )  # fmt: skip
    ax.set_xlim(ego.x[0] - BEHIND, ego.x[0] + AHEAD)
    ax.set_ylim(low - 1.0, low + 11.5)
    ax.tick_params(labelsize=7)


def main() -> None:
    """Drive and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("run")
    parser.add_argument("rule")
    parser.add_argument("out")
    parser.add_argument("--failure", type=int)
    args = parser.parse_args()
    result = Run.read(args.run)[args.rule]
    trace = avrare.trace(result, args.failure)
    loop, dt = result.require_origin().problem.system, trace.times[1] - trace.times[0]
    states = drive(loop, np.asarray(trace.noise))
    last = len(states) - 1
    figure, ax = plt.subplots(figsize=(8.0, 1.7), dpi=80, layout="constrained")
    frames = [*range(0, last, EVERY), *[last] * 5]
    film = FuncAnimation(
        figure, lambda k: draw(ax, loop, trace.scene, states[k], k * dt), frames=frames, blit=False
    )
    film.save(f"{args.out}.gif", writer=PillowWriter(fps=round(1.0 / (EVERY * dt))))
    figure, axes = plt.subplots(4, 1, figsize=(8.0, 5.6), dpi=80, layout="constrained")
    for ax, share in zip(axes, (0.0, 0.5, 0.8, 1.0), strict=True):
        k = round(share * last)
        draw(ax, loop, trace.scene, states[k], k * dt)
    figure.savefig(f"{args.out}.png")


if __name__ == "__main__":
    main()
