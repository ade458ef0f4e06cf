"""Cars to track, and what is seen of them."""

import numpy as np

from avrare.driving import Observation, Road, Scene, Vehicles, World

LANES = (-1.75, 1.75, 5.25)


def scene(vehicles: int) -> Scene:
    return Scene(
        dt=0.1,
        road=Road(LANES, 3.5),
        ego_length=4.3,
        ego_width=1.7,
        names=tuple(f"car{k}" for k in range(vehicles)),
        lengths=np.full(vehicles, 4.3),
        widths=np.full(vehicles, 1.7),
        moving=np.ones(vehicles, bool),
    )


def world(x, y, heading, speed, acceleration) -> World:
    n = len(x)
    none = np.zeros(n)
    return World(
        step=np.zeros(n, dtype=np.int64),
        ego=Vehicles(none, none, none, none, none),
        others=Vehicles(x, y, heading, speed, acceleration),
        steering=none,
    )


def lane_change(n: int, steps: int = 60):
    """Return (steps + 1, n, 1) x, y, vx of a car that speeds up, waits, then moves one lane to the left."""
    t = np.arange(steps + 1) * 0.1
    speed = 15 + 2 * t
    x = np.concatenate([[0.0], np.cumsum(0.1 * speed[:-1])])
    y, vy, path = 1.75, 0.0, []
    for k in range(steps + 1):
        path.append(y)
        goal = 1.75 if k < 15 else 5.25
        y, vy = y + 0.1 * vy, vy + 0.1 * (7 * (goal - y) - 4 * vy)
    return (np.broadcast_to(a[:, None, None], (steps + 1, n, 1)) for a in (x, np.array(path), speed))


def noisy(rng, x, y, vx, missing=0.0) -> Observation:
    seen = rng.random(x.shape) >= missing
    sd = np.sqrt(0.1)
    return Observation(seen, *(np.where(seen, a + rng.normal(0, sd, a.shape), np.nan) for a in (x, y, vx)))
