"""Scenes and worlds of vehicles, and a fitted model, as fixtures of the tests of perception."""

from types import SimpleNamespace

import numpy as np
import pytest

from avrare.base import batch
from avrare.driving import Road, Scene, Vehicles, World
from avrare_gp_pem.runtime.store import load, locate


def make_scene(count, length=4.5, width=1.8):
    names, lengths, widths = [f"car{i}" for i in range(count)], np.full(count, length), np.full(count, width)
    return Scene(0.1, Road((0.0, 3.5), 3.5), 4.5, 1.8, tuple(names), lengths, widths, np.ones(count, bool))


def make_world(others, ego=(0.0, 0.0, 0.0), n=1, speed=10.0):
    """Return a world of ``others``, (V, 3) or (N, V, 3), and ``ego``: x, y, heading."""
    others = np.asarray(others, float)
    if others.ndim == 2:
        others = np.repeat(others[None], n, axis=0)
    poses = np.broadcast_to(np.asarray(ego, float), (len(others), 3))

    def vehicles(pose):
        x, y, heading = (np.ascontiguousarray(pose[..., i]) for i in range(3))
        return Vehicles(x, y, heading, np.full_like(x, speed), np.zeros_like(x))

    zeros = np.zeros(len(others))
    return World(zeros.astype(np.int64), vehicles(poses), vehicles(others), zeros)


def turned(world, angle, shift=(0.0, 0.0)):
    """Return the same world seen from a rotated and shifted world frame."""
    cos, sin = np.cos(angle), np.sin(angle)

    def move(v):
        x, y = cos * v.x - sin * v.y + shift[0], sin * v.x + cos * v.y + shift[1]
        return Vehicles(x, y, v.heading + angle, v.speed, v.acceleration)

    return World(world.step, move(world.ego), move(world.others), world.steering)


def random_world(n, v, seed=0):
    rng = np.random.default_rng(seed)
    pose = [rng.uniform(*ends, (n, v)) for ends in ((-30, 80), (-10, 10), (-3, 3))]
    ego = [rng.uniform(-end, end, n) for end in (5, 2, 0.5)]
    return make_world(np.stack(pose, axis=-1), np.stack(ego, axis=-1))


def follow(model, world, steps, seed=0):
    """Return noise, observations and memories of steps 1.., the world standing still."""
    noise = np.random.default_rng(seed).standard_normal((steps + 1, len(world.step), model.noise_size))
    memory, seen, memories = model.start(noise[0]), [], []
    for row in noise[1:]:
        before = [leaf.tobytes() for leaf in batch.leaves(memory)]
        observation, after = model.follow(world, row, memory)
        assert [leaf.tobytes() for leaf in batch.leaves(memory)] == before
        memory = after
        seen.append(observation)
        memories.append(memory)
    return noise, seen, memories


def check_rows(predict, inputs):
    """Compare what is predicted for rows in other batches and at other places, bit for bit."""
    x = np.random.default_rng(3).normal(size=(257, inputs))
    whole = predict(x)
    for count in (1, 2, 3, 47, 48, 49, 200):
        for rows, last in zip(whole, predict(x[-count:]), strict=True):
            assert rows[-count:].tobytes() == last.tobytes()
    for shift in range(1, 50):
        for rows, rolled in zip(whole, predict(np.roll(x, shift, axis=0)), strict=True):
            assert np.roll(rolled, -shift, axis=0).tobytes() == rows.tobytes()


def change_file(path, **changes):
    """Replace some arrays of a stored model."""
    with np.load(path) as file:
        arrays = dict(file)
    assert changes.keys() <= arrays.keys()
    np.savez(path, **(arrays | {name: np.array(value) for name, value in changes.items()}))


@pytest.fixture(scope="session")
def make():
    """Return functions that make scenes and worlds."""
    return SimpleNamespace(scene=make_scene, world=make_world, turned=turned, random=random_world)


@pytest.fixture(scope="session")
def pointpillars():
    return load(locate("pointpillars"))
