"""Rendering of worlds without a display, as frames or as a GIF."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.stack.closed_loop import ClosedLoop
from avrare_highway_env.simulator import HighwayEnvSimulator, HighwayWorld
from avrare_highway_env.worlds import restore

Frame = NDArray[np.uint8]


def roll(system: ClosedLoop, tape: Floats) -> list[HighwayWorld]:
    """Return the worlds of one rollout of a closed loop around a ``highway_env`` simulator.

    Args:
        system: The closed loop, such as ``scenario.stack.loop``.
        tape: Noise tape (steps + 1, noise_size).
    """
    state = system.initial(tape[None, 0])
    worlds = [state.world]
    for row in tape[1:]:
        state = system.step(state, row[None])
        worlds.append(state.world)
    return worlds


def frames(simulator: HighwayEnvSimulator, worlds: Iterable[HighwayWorld], row: int = 0) -> list[Frame]:
    """Render top views (height, width, 3) of one row of each world; repeated worlds are rendered once.

    Raises:
        UsageError: SDL's dummy video driver is selected, with which highway-env draws nothing.
    """
    if os.environ.get("SDL_VIDEODRIVER") == "dummy":
        raise UsageError("SDL_VIDEODRIVER=dummy makes every picture black", "unset SDL_VIDEODRIVER")
    environment = simulator.environment
    mode, environment.render_mode = environment.render_mode, "rgb_array"
    pictures: list[Frame] = []
    last = None
    try:
        for world in worlds:
            if world.snapshot[row] is last:
                continue
            last = world.snapshot[row]
            restore(environment, last)
            pictures.append(np.asarray(environment.render(), dtype=np.uint8))
    finally:
        environment.close()
        environment.render_mode = mode
    return pictures


def save_gif(path: Path, pictures: Sequence[Frame], dt: float) -> None:
    """Write frames as an animation at the speed of the simulated time.

    Args:
        path: File to write, ``.gif``.
        pictures: Frames of one size.
        dt: Time between two frames [s].

    Raises:
        UsageError: Pillow is not installed.
    """
    try:
        from PIL import Image
    except ImportError as error:
        raise UsageError("pictures need pillow", "pip install 'avrare-highway-env[render]'") from error
    first, *rest = (Image.fromarray(picture) for picture in pictures)
    first.save(path, save_all=True, append_images=rest, duration=round(1000 * dt), loop=0)
