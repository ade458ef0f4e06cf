"""Worlds for tests; importable by worker processes as ``toys``."""

import contextlib
import random
import time

import numpy as np

from avrare.testing import faulty_systems as systems


class Walk:
    """x += 0.1 w, from 0.1 w."""

    noise_size = 1

    def reset(self, noise):
        self.x = 0.1 * float(noise[0])

    def step(self, action, noise):
        self.x += 0.1 * float(noise[0]) + (0.0 if action is None else float(np.sum(action)))

    def signals(self):
        return {"x": self.x}


class Hooked(Walk):
    def snapshot(self):
        return self.x

    def restore(self, snapshot):
        self.x = snapshot


class Entangled(Walk):
    """Its copies share what they should not."""

    def __init__(self):
        self.shared = [0.0]

    def reset(self, noise):
        self.shared[0] = 0.1 * float(noise[0])

    def step(self, action, noise):
        self.shared[0] += 0.1 * float(noise[0])

    def signals(self):
        return {"x": self.shared[0]}

    def __deepcopy__(self, memo):
        other = type(self)()
        other.shared = self.shared
        return other


class Brittle(Walk):
    """Its copies are of no use."""

    def step(self, action, noise):
        if getattr(self, "copied", False):
            raise AssertionError
        super().step(action, noise)

    def __deepcopy__(self, memo):
        other = type(self)()
        other.x, other.copied = self.x, True
        return other


class Vector(Walk):
    """Two numbers and a vector; the controller sees something else."""

    def signals(self):
        return {"x": self.x, "both": np.array([self.x, -self.x])}

    def observation(self):
        return np.array([self.x, 1.0])


class Displaced(Walk):
    def displace(self, delta):
        self.x += float(delta[0])


class Careless(Walk):
    """Draws from the global generator too."""

    def step(self, action, noise):
        super().step(action, noise)
        self.x += 1e-3 * random.random()


class LateCareless(Walk):
    """Draws from the global generator too, but not in the first steps, which are tried beforehand."""

    def reset(self, noise):
        super().reset(noise)
        self.steps = 0

    def step(self, action, noise):
        super().step(action, noise)
        self.steps += 1
        if self.steps > 12:
            self.x += 1e-3 * random.random()


class Leaky(Walk):
    """A reset does not undo everything."""

    used = 0.0

    def reset(self, noise):
        super().reset(noise)
        self.x += self.used
        self.used += 1e-3


class Raising(Walk):
    """Breaks down where the noise is large."""

    tried = 0

    def step(self, action, noise):
        if noise[0] > 2.0:
            Raising.tried += 1
            raise ValueError("too large")
        super().step(action, noise)


class Exiting(Walk):
    def step(self, action, noise):
        if noise[0] > 2.0:
            raise SystemExit(3)
        super().step(action, noise)


class Missing(Walk):
    """Has no number to give where the noise is large."""

    def step(self, action, noise):
        super().step(action, noise)
        if noise[0] > 2.0:
            self.x = np.nan


class Hanging(Walk):
    """Never ends where the noise is large, whatever it is told."""

    def step(self, action, noise):
        while noise[0] > 2.0:
            with contextlib.suppress(Exception):
                time.sleep(60)
        super().step(action, noise)


class Push:
    """A controller that remembers how often it has acted."""

    horizon = 0

    def start(self, n):
        return np.zeros(n, dtype=np.int64)

    def act(self, memory, seen, prediction):
        return -0.1 * seen[:, :1] + 0.01 * memory[:, None], memory + 1

    def counts(self, memory):
        return {"acted": memory}


class BatchWalk(systems.Walk):
    """``Walk`` as a system of arrays."""

    def initial(self, noise):
        return {"x": self.move(0.0, noise)}
