"""Scenes of single_track with drivers that react, and their drives."""

import numpy as np

from avrare.driving import Action
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.simulator import build

EGO = {"x": -200.0, "y": -1.75, "speed": 20.0}


def car(name, x, y=1.75, speed=20.0, desired=25.0, **driver):
    sizes = {key: driver.pop(key) for key in ("length", "width") if key in driver}
    return {
        "name": name, "x": x, "y": y, "speed": speed, **sizes,
        "driver": {"desired_speed": desired, "lane_changes": False, **driver},
    }  # fmt: skip


def simulator(*vehicles, ego=EGO, dt=0.1):
    return build(SingleTrackConfig.model_validate({"dt": dt, "ego": ego, "vehicles": list(vehicles)}))


def drive(sim, steps, n=1, seed=None):
    """Return the worlds of a drive whose ego keeps its speed."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((steps + 1, n, sim.noise_size)) * (seed is not None)
    worlds = [sim.reset(noise[0])]
    for row in noise[1:]:
        worlds.append(sim.step(worlds[-1], Action(np.zeros(n), np.zeros(n)), row))
    return worlds


def dense(**driver):
    return [
        car(f"v{k}", 28.0 * (k // 3) + 4.0 * (k % 3), (-1.75, 1.75, 5.25)[k % 3], 20.0 + k % 5, 23.0 + k % 7,
            lane_changes=True, **driver)
        for k in range(12)
    ]  # fmt: skip
