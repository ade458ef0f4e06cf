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


class Demanding(Options):
    model_config = ConfigDict(json_schema_extra={"examples": [{"weight": 2.0}]})

    weight: float = Field(description="a pure number")


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


class Listing(Walk):
    def signals(self, world):
        return {"x": world.x.tolist()}


class Rolling(Walk):
    def step(self, world, action, noise):
        return World(world.x + noise[:, 0] + random.random())


class Remembering(Walk):
    calls = 0

    def step(self, world, action, noise):
        self.calls += 1
        return World(world.x + self.calls * noise[:, 0])


class Sociable(Walk):
    def step(self, world, action, noise):
        return World(world.x + noise[:, 0] - 0.1 * world.x.mean())


class Writing(Walk):
    def step(self, world, action, noise):
        world.x[:] += noise[:, 0]
        return World(world.x)


class Opaque(Walk):
    """Its states are no values."""

    class Box:
        def __init__(self, x):
            self.x = x

    def reset(self, noise):
        return self.Box(noise[:, 0])

    def step(self, world, action, noise):
        return self.Box(world.x + noise[:, 0])


class Fussy(Walk):
    def step(self, world, action, noise):
        if np.isnan(noise).any():
            raise ValueError("NaN")
        return super().step(world, action, noise)


class Steered(Walk):
    """Nothing is wrong with it: it reads what its controller says."""

    def step(self, world, action, noise):
        return World(world.x + noise[:, 0] + action[:, 0])


class Asking(Walk):
    def step(self, world, action, noise):
        raise UsageError("this walk needs a controller")


class Mistyped(Walk):
    def step(self, world, action, noise):
        raise TypeError("can only add numbers")


class Windless(Walk):
    """Stumbles over a None of its own."""

    def step(self, world, action, noise):
        return World(self.wind.x + noise[:, 0])

    wind = None


class Stepless:
    dt, noise_size = 0.1, 1


def build(kind):
    return lambda config, scene=None: kind()


_KINDS = (
    Listing,
    Rolling,
    Remembering,
    Sociable,
    Writing,
    Opaque,
    Fussy,
    Stepless,
    Steered,
    Asking,
    Mistyped,
    Windless,
)
for _kind in _KINDS:
    globals()[_kind.__name__.lower()] = build(_kind)


class Half(MonteCarlo):
    """Half of everything."""

    def estimate(self, state):
        results = super().estimate(state)
        return [replace(one, probability=one.probability / 2, run_probabilities=one.run_probabilities / 2,
                        interval_at=lambda c, one=one: tuple(x / 2 for x in one.interval_at(c)))
                for one in results]  # fmt: skip


class Overconfident(MonteCarlo):
    def estimate(self, state):
        results = super().estimate(state)
        return [replace(one, interval_at=lambda c, one=one: (0.95 * one.probability, one.probability))
                for one in results]  # fmt: skip


class Pessimist(MonteCarlo):
    """Never below one in a thousand."""

    def estimate(self, state):
        return [replace(one, probability=max(one.probability, 1e-3)) for one in super().estimate(state)]


class Forgiving(MonteCarlo):
    """Errors are not counted."""

    def estimate(self, state):
        return [replace(one, errors=0) for one in super().estimate(state)]


class Cheap(MonteCarlo):
    def estimate(self, state):
        return [replace(one, simulated_steps=1) for one in super().estimate(state)]


class Spender(MonteCarlo):
    def init(self, plan):
        return super().init(replace(plan, budget=None))


class Chunky(MonteCarlo):
    """Part whose outcome depends on the size of the chunks."""

    def init(self, plan):
        state, info = super().init(plan)
        return (replace(state, total=500, per_run=500), info) if plan.chunk < 100 else (state, info)


class Shuffling(MonteCarlo):
    """The runs are told in another order when there are more of them."""

    def estimate(self, state):
        return [
            replace(one, run_probabilities=one.run_probabilities[::-1]) for one in super().estimate(state)
        ]


class Rounding(MonteCarlo):
    """The estimate is not the mean of its runs."""

    def estimate(self, state):
        return [replace(one, probability=round(one.probability, 3)) for one in super().estimate(state)]


class Forging(MonteCarlo):
    """The tapes of its failures are not those that failed."""

    def estimate(self, state):
        return [replace(one, failures=replace(one.failures, noise=-one.failures.noise))
                for one in super().estimate(state)]  # fmt: skip


def estimator(kind):
    return lambda config, scene=None: kind(config)


_ESTIMATORS = (
    Half,
    Overconfident,
    Pessimist,
    Forgiving,
    Cheap,
    Spender,
    Chunky,
    Shuffling,
    Rounding,
    Forging,
)
for _kind in _ESTIMATORS:
    globals()[_kind.__name__.lower()] = estimator(_kind)


class Lenient(McConfig):
    model_config = ConfigDict(extra="ignore", frozen=True)


class Backwards(SerialExecutor):
    def map(self, chunks):
        return iter(list(super().map(chunks))[::-1])


class Greedy(SerialExecutor):
    def map(self, chunks):
        return super().map(list(chunks))


class Once(SerialExecutor):
    used = False

    def open(self, work):
        if self.used:
            raise UsageError("closed")
        super().open(work)

    def close(self):
        self.used = True


class Deaf(SerialExecutor):
    """Errors are swallowed."""

    def map(self, chunks):
        for chunk in chunks:
            try:
                yield self._work.run(chunk)
            except Exception:
                yield Rollouts


class Idle(SerialExecutor):
    """Errands are not run."""

    def map(self, chunks):
        return (self._work.run(chunk) if isinstance(chunk, Request) else None for chunk in chunks)


for _kind in (Backwards, Greedy, Once, Deaf, Idle):
    globals()[_kind.__name__.lower()] = build(_kind)


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


class Forgetful(Drift):
    """Keeps its memory in itself."""

    def follow(self, world, noise, memory):
        kept = getattr(self, "kept", None)
        observation, self.kept = super().follow(
            world, noise, memory if kept is None else np.resize(kept, noise.shape)
        )
        return observation, memory


class Smearing(Drift):
    """Errors begin at the mean of all particles."""

    def start(self, noise):
        return noise - noise.mean(axis=0)


class Scribbling(Drift):
    """Writes into the memory."""

    def follow(self, world, noise, memory):
        memory *= 0.5
        memory += noise
        return self.observe(world, memory), memory


def lasting(config, scene):
    return Drift()


def forgetful(config, scene):
    return Forgetful()


def smearing(config, scene):
    return Smearing()


def scribbling(config, scene):
    return Scribbling()


def draw_words(result):
    return (f"a chart of {result.specification}",)
