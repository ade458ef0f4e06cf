"""Drawn numbers of worlds: the same for every way of copying, in this process and in another."""

import pickle

import numpy as np
import pytest

from avrare.base import batch
from avrare.worlds.worlds_simulator import DrawnWorlds


class Walk:
    """A walk with a drift of its own."""

    noise_size = 1

    def __init__(self):
        self.options = {"drift": 0.0}

    def assign(self, values):
        self.options |= values

    def reset(self, noise):
        self.x, self.drift = float(noise[0]), self.options["drift"]

    def step(self, action, noise):
        self.x += self.drift + float(noise[0])

    def signals(self):
        return {"x": self.x}

    def snapshot(self):
        return self.x, self.drift

    def restore(self, snapshot):
        self.x, self.drift = snapshot


def drive(worlds, world, noise):
    for row in noise:
        world = worlds.step(world, None, row)
    return world


@pytest.mark.parametrize("copy", ["replay", "deepcopy", "hook"])
def test_branches_keep_their_numbers(copy):
    worlds = DrawnWorlds(Walk, copy=copy).drawing({"drift": None})
    assert worlds.noise_size == 1
    noise = np.random.default_rng(0).standard_normal((7, 3, 1))
    drift = np.array([0.0, 10.0, 20.0])
    start = worlds.reset_drawn(noise[0], {"drift": drift})
    middle = drive(worlds, start, noise[1:4])
    order = np.array([2, 2, 0])
    copies = batch.take(middle, order)
    end = drive(worlds, copies, noise[4:])
    expected = noise[:4].sum(axis=0)[order, 0] + noise[4:].sum(axis=0)[:, 0] + 6 * drift[order]
    np.testing.assert_allclose(worlds.signals(end)["x"], expected)
    elsewhere, again = pickle.loads(pickle.dumps((worlds, copies)))  # as workers do
    np.testing.assert_array_equal(
        elsewhere.signals(drive(elsewhere, again, noise[4:]))["x"], worlds.signals(end)["x"]
    )


def test_without_draws_nothing_changes():
    worlds = DrawnWorlds(Walk)
    noise = np.random.default_rng(0).standard_normal((3, 2, 1))
    end = drive(worlds, worlds.reset(noise[0]), noise[1:])
    np.testing.assert_allclose(worlds.signals(end)["x"], noise.sum(axis=0)[:, 0])
