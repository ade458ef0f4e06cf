"""Components that each break one promise; ``avrare plugins --check`` must notice."""

import random
from dataclasses import dataclass, replace

import numpy as np
from pydantic import ConfigDict, Field

from avrare.base.errors import UsageError
from avrare.driving import Observation
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.plugin import Options
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.request import Request, Rollouts


def offer(kind):
    """Let a factory without options have the lower-case name of a class."""
    globals()[kind.__name__.lower()] = lambda config, scene=None: kind()
    return kind


class Weighted(Options):
    weight: float = Field(default=1.0, description="a pure number")


class Loose(Options):
    model_config = ConfigDict(extra="ignore")

    weight: float = Field(default=1.0, description="a pure number")


class Silent(Options):
    weight: float = 1.0


class Unitless(Options):
    top_speed: float = Field(default=1.0, description="as fast as it goes")


def hidden():
    class Hidden(Weighted):
        """Pickle does not find it."""

    return Hidden


Hidden = hidden()


class Insatiable(Options):
    weight: float = Field(description="a pure number")


@dataclass(frozen=True)
class World:
    x: np.ndarray


class Walk:
    """Keeps every promise; the others change one method."""

    dt = 0.1
    noise_size = 1

    def reset(self, noise):
        return World(noise[:, 0].copy())

    def step(self, world, action, noise):
        return World(world.x + noise[:, 0])

    def signals(self, world):
        return {"x": world.x}


def good(config, scene=None):
    return Walk()


@offer
class Listing(Walk):
    def signals(self, world):
        return {"x": world.x.tolist()}


@offer
class Rolling(Walk):
    def step(self, world, action, noise):
        return World(world.x + noise[:, 0] + random.random())


@offer
class Remembering(Walk):
    calls = 0

    def step(self, world, action, noise):
        self.calls += 1
        return World(world.x + self.calls * noise[:, 0])


@offer
class Sociable(Walk):
    def step(self, world, action, noise):
        return World(world.x + noise[:, 0] - 0.1 * world.x.mean())


@offer
class Writing(Walk):
    def step(self, world, action, noise):
        world.x[:] += noise[:, 0]
        return World(world.x)


@offer
class Opaque(Walk):
    """Its states are no values."""

    class Box:
        def __init__(self, x):
            self.x = x

    def reset(self, noise):
        return self.Box(noise[:, 0])

    def step(self, world, action, noise):
        return self.Box(world.x + noise[:, 0])


@offer
class Fussy(Walk):
    def step(self, world, action, noise):
        if np.isnan(noise).any():
            raise ValueError("NaN")
        return super().step(world, action, noise)


@offer
class Steered(Walk):
    """Nothing is wrong with it: it reads what its controller says."""

    def step(self, world, action, noise):
        return World(world.x + noise[:, 0] + action[:, 0])


@offer
class Asking(Walk):
    def step(self, world, action, noise):
        raise UsageError("this walk needs a controller")


@offer
class Mistyped(Walk):
    def step(self, world, action, noise):
        raise TypeError("can only add numbers")


@offer
class Windless(Walk):
    """Stumbles over a None of its own."""

    def step(self, world, action, noise):
        return World(self.wind.x + noise[:, 0])

    wind = None


@offer
class Stepless:
    dt, noise_size = 0.1, 1


def lying(lie):
    """Return the factory of Monte Carlo that changes each of its results."""

    class Liar(MonteCarlo):
        def estimate(self, state):
            return [lie(result) for result in super().estimate(state)]

    return lambda config, scene=None: Liar(config)


def halve(result):
    return replace(result, probability=result.probability / 2, run_probabilities=result.run_probabilities / 2,
                   interval_at=lambda c: tuple(x / 2 for x in result.interval_at(c)))  # fmt: skip


half = lying(halve)
overconfident = lying(lambda r: replace(r, interval_at=lambda c: (0.95 * r.probability, r.probability)))
pessimist = lying(lambda r: replace(r, probability=max(r.probability, 1e-3)))
forgiving = lying(lambda r: replace(r, errors=0))
cheap = lying(lambda r: replace(r, simulated_steps=1))
rounding = lying(lambda r: replace(r, probability=round(r.probability, 3)))
forging = lying(lambda r: replace(r, failures=replace(r.failures, noise=-r.failures.noise)))
shuffling = lying(lambda r: replace(r, run_probabilities=r.run_probabilities[::-1]))


class Spender(MonteCarlo):
    def init(self, plan):
        return super().init(replace(plan, budget=None))


class Chunky(MonteCarlo):
    """Has outcomes that depend on the size of the chunks."""

    def init(self, plan):
        state, info = super().init(plan)
        return (replace(state, total=500, per_run=500), info) if plan.chunk < 100 else (state, info)


def spender(config, scene=None):
    return Spender(config)


def chunky(config, scene=None):
    return Chunky(config)


class Lenient(McConfig):
    model_config = ConfigDict(extra="ignore", frozen=True)


@offer
class Backwards(SerialExecutor):
    def map(self, chunks):
        return iter(list(super().map(chunks))[::-1])


@offer
class Greedy(SerialExecutor):
    def map(self, chunks):
        return super().map(list(chunks))


@offer
class Once(SerialExecutor):
    used = False

    def open(self, work):
        if self.used:
            raise UsageError("closed")
        super().open(work)

    def close(self):
        self.used = True


@offer
class Deaf(SerialExecutor):
    """Errors are swallowed."""

    def map(self, chunks):
        for chunk in chunks:
            try:
                yield self._work.run(chunk)
            except Exception:
                yield Rollouts


@offer
class Idle(SerialExecutor):
    """Errands are not run."""

    def map(self, chunks):
        return (self._work.run(chunk) if isinstance(chunk, Request) else None for chunk in chunks)


class Drift:
    """A perception model whose error along the road is half the last one and something new."""

    noise_size = 3

    def observe(self, world, noise):
        others = world.others
        return Observation(np.ones(others.x.shape, bool), others.x + noise, others.y, others.speed)

    def start(self, noise):
        return noise.copy()

    def follow(self, world, noise, memory):
        error = 0.5 * memory + noise
        return self.observe(world, error), error


@offer
class Forgetful(Drift):
    """Keeps its memory in itself."""

    def follow(self, world, noise, memory):
        kept = getattr(self, "kept", memory)
        observation, self.kept = super().follow(world, noise, np.resize(kept, noise.shape))
        return observation, memory


@offer
class Smearing(Drift):
    """Errors begin at the mean of all particles."""

    def start(self, noise):
        return noise - noise.mean(axis=0)


@offer
class Scribbling(Drift):
    """Writes into the memory."""

    def follow(self, world, noise, memory):
        memory *= 0.5
        memory += noise
        return self.observe(world, memory), memory


def lasting(config, scene):
    return Drift()


def draw_words(result):
    return (f"a chart of {result.specification}",)
