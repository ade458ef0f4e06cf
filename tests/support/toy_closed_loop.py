"""A closed loop in one dimension with an exact answer: perception's errors add up."""

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

import avrare
from avrare.driving import Action, Observation, Road, Scene, Vehicles
from avrare.stack.closed_loop import ClosedLoop

PHI = NormalDist()


@dataclass(frozen=True)
class OneRoad:
    """Ego and one other vehicle; ``believed`` is what the controller heard last."""

    step: np.ndarray
    ego: Vehicles
    others: Vehicles
    lost: np.ndarray


@dataclass(frozen=True)
class Line:
    """The other vehicle stands 10 m ahead; ``lost`` adds up what the controller asks for."""

    scene: Scene
    dt = 1.0
    noise_size = 1

    def reset(self, noise):
        n = len(noise)
        zero, one = np.zeros(n), np.zeros((n, 1))
        ego = Vehicles(zero, zero, zero, zero, zero)
        others = Vehicles(one + 10.0, one, one, one, one)
        return OneRoad(np.zeros(n, dtype=np.int64), ego, others, zero)

    def step(self, world, action, noise):
        return OneRoad(world.step + 1, world.ego, world.others, world.lost + action.acceleration)

    def signals(self, world):
        return {"lost": world.lost}


@dataclass(frozen=True)
class NormalLaw:
    """Detected with a probability, then normal errors along and across."""

    detect: np.ndarray
    miss: np.ndarray
    location: np.ndarray
    scale: np.ndarray

    def draw(self, world, noise):
        parts = noise.reshape(*self.detect.shape, 3)
        rank = np.vectorize(PHI.cdf)(parts[..., 0]) if parts.size else parts[..., 0]
        detected = rank < self.detect
        missing = np.where(detected, 0.0, np.nan)
        error = self.location + self.scale * parts[..., 1:]
        x, y = world.others.x - error[..., 0] + missing, world.others.y - error[..., 1] + missing
        return Observation(detected, x, y, world.others.speed + missing)

    def log_prob(self, world, observation):
        seen = np.log(self.detect)
        for axis, (true, read) in enumerate(
            [(world.others.x, observation.x), (world.others.y, observation.y)]
        ):
            error = np.where(observation.detected, true - read, 0.0)
            standard = (error - self.location[..., axis]) / self.scale[..., axis]
            density = -0.5 * standard * standard - np.log(self.scale[..., axis] * math.sqrt(2 * math.pi))
            seen = seen + density
        return np.where(observation.detected, seen, np.log(self.miss)).sum(axis=-1)


@dataclass(frozen=True)
class Pem:
    """Constant law: detection probability, bias and standard deviation of both errors."""

    scene: Scene
    detection: float = 0.9
    bias: float = 0.0
    sd: float = 1.0
    noise_size = 3

    def law(self, world):
        shape = world.others.x.shape
        both = (*shape, 2)
        detect = np.full(shape, self.detection)
        return NormalLaw(detect, 1.0 - detect, np.full(both, self.bias), np.full(both, self.sd))

    def observe(self, world, noise):
        return self.law(world).draw(world, noise)

    def log_prob(self, world, observation):
        return self.law(world).log_prob(world, observation)


class Blind(Pem):
    """A perception whose density nobody knows."""

    log_prob = property()
    law = property()


class LastSeen:
    """Keeps the error of the last observation, and counts misses."""

    def start(self, world):
        return np.zeros(len(world.step))

    def update(self, track, observation):
        error = np.where(observation.detected, 10.0 - observation.x, MISS)
        return error[:, 0]

    def predict(self, track, steps):
        return track


class Believes:
    """Asks for what was heard last: the sum of the errors is what gets lost."""

    horizon = 0

    def start(self, n):
        return np.zeros(n)

    def act(self, memory, ego, prediction):
        return Action(prediction, np.zeros_like(prediction)), memory


MISS = 0.5
"""Distance that a missed detection costs [m]."""


def scene():
    one = np.ones(1)
    return Scene(1.0, Road((0.0,), 3.5), 4.5, 1.8, ("parked",), 4.5 * one, 1.8 * one, np.zeros(1, bool))


def final_only(limit, steps=6, perception=None, chunk=1024):
    """Return the problem in which only the last sample counts, which has an exact answer."""
    here = scene()
    loop = ClosedLoop(Line(here), perception or Pem(here), LastSeen(), Believes())
    rule = avrare.stl(f"always[{steps}:{steps} samples] (lost < {limit})")
    return avrare.Problem(loop, rule, steps, chunk=chunk)


def exact(limit, steps=6, detection=0.9, bias=0.0, sd=1.0):
    """Return P(sum of the errors >= limit): a binomial mixture of normal tails."""
    terms, total = steps - 1, 0.0
    for seen in range(terms + 1):
        weight = math.comb(terms, seen) * detection**seen * (1 - detection) ** (terms - seen)
        rest = limit - MISS * (terms - seen) - bias * seen
        tail = 1.0 - PHI.cdf(rest / (sd * math.sqrt(seen))) if seen else float(rest <= 0)
        total += weight * tail
    return total
