"""Worlds and models that the tests share."""

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


@pytest.fixture(params=["gp_pem", "parametric"])
def build(request):
    """Return a function of (scene, **options) that builds either model the way a scenario does."""
    import avrare_gp_pem

    component = next(c for c in avrare_gp_pem.avrare_components() if c.name == request.param)
    return lambda scene, **options: component.load_factory()(component.load_config()(**options), scene)


def made_up_drive(n, artefact=False, rate=None, seed=0):
    """Return rows with a known law: logistic detection, Student-t errors along and across; flips of yaw."""
    from avrare_gp_pem.training.table import make_table

    rng = np.random.default_rng(seed)
    distance, bearing = rng.uniform(3, 80, n), rng.uniform(-np.pi, np.pi, n)
    yaw = rng.uniform(-np.pi, np.pi, n)
    aligned = rng.uniform(size=n) < 0.5
    yaw = np.where(aligned, np.round(yaw / (np.pi / 2)) * np.pi / 2 + rng.normal(0, 0.005, n), yaw)
    detect = np.asarray(true_detection(distance) if rate is None else np.full(n, rate))
    if artefact:
        detect = np.where(aligned, 0.4 * detect, detect)
    along, across = true_scales(distance) * rng.standard_t(3, (2, n))
    cos, sin = np.cos(yaw), np.sin(yaw)
    flips = np.where(rng.uniform(size=n) < 0.1, np.pi, 0.0)
    return make_table(
        {
            "right": distance * np.cos(bearing),
            "forward": distance * np.sin(bearing),
            "yaw": yaw,
            "length": rng.normal(4.6, 0.3, n),
            "width": rng.normal(1.9, 0.1, n),
            "height": rng.normal(1.7, 0.1, n),
            "visibility": rng.integers(1, 5, n).astype(float),
            "detected": (rng.uniform(size=n) < detect).astype(float),
            "error_right": cos * along - sin * across,
            "error_forward": sin * along + cos * across,
            "error_yaw": np.abs(flips - np.abs(0.02 * rng.standard_t(3, n))),
        }
    )


def true_detection(distance):
    return 0.97 / (1 + np.exp((distance - 45) / 5))


def true_scales(distance):
    return np.stack([0.05 + 0.006 * distance, 0.03 + 0.003 * distance])


@pytest.fixture(scope="session")
def drive():
    """Return a function that makes up a table, with the true law as its attributes."""
    made_up_drive.detection, made_up_drive.scales = true_detection, true_scales
    return made_up_drive
