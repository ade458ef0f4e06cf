"""Scenes and worlds of vehicles, and a fitted model, as fixtures of the tests of perception."""

from types import SimpleNamespace

import numpy as np
import pytest

from avrare.driving import Road, Scene, Vehicles, World
from avrare_gp_pem.runtime.store import load, locate


def make_scene(count, length=4.5, width=1.8):
    return Scene(
        dt=0.1,
        road=Road((0.0, 3.5), 3.5),
        ego_length=4.5,
        ego_width=1.8,
        names=tuple(f"car{i}" for i in range(count)),
        lengths=np.full(count, length),
        widths=np.full(count, width),
        moving=np.ones(count, bool),
    )


def make_world(others, ego=(0.0, 0.0, 0.0), n=1, speed=10.0):
    """Return a world of ``others``, (V, 3) or (N, V, 3), and ``ego``: x, y, heading."""
    others = np.asarray(others, float)
    if others.ndim == 2:
        others = np.repeat(others[None], n, axis=0)
    poses = np.broadcast_to(np.asarray(ego, float), (len(others), 3))

    def vehicles(pose):
        x, y, heading = (np.ascontiguousarray(pose[..., i]) for i in range(3))
        return Vehicles(x, y, heading, np.full_like(x, speed), np.zeros_like(x))

    return World(
        step=np.zeros(len(others), np.int64),
        ego=vehicles(poses),
        others=vehicles(others),
        steering=np.zeros(len(others)),
    )


def turned(world, angle, shift=(0.0, 0.0)):
    """Return the same world seen from a rotated and shifted world frame."""
    cos, sin = np.cos(angle), np.sin(angle)

    def move(v):
        x, y = cos * v.x - sin * v.y + shift[0], sin * v.x + cos * v.y + shift[1]
        return Vehicles(x, y, v.heading + angle, v.speed, v.acceleration)

    return World(world.step, move(world.ego), move(world.others), world.steering)


def random_world(n, v, seed=0):
    rng = np.random.default_rng(seed)
    pose = np.stack(
        [rng.uniform(-30, 80, (n, v)), rng.uniform(-10, 10, (n, v)), rng.uniform(-3, 3, (n, v))], axis=-1
    )
    ego = np.stack([rng.uniform(-5, 5, n), rng.uniform(-2, 2, n), rng.uniform(-0.5, 0.5, n)], axis=-1)
    return make_world(pose, ego)


@pytest.fixture(scope="session")
def make():
    """Return functions that make scenes and worlds (tests cannot import from one another)."""
    return SimpleNamespace(scene=make_scene, world=make_world, turned=turned, random=random_world)


@pytest.fixture(scope="session")
def pointpillars():
    return load(locate("pointpillars"))
