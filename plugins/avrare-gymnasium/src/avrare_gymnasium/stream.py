"""Random numbers of an environment, derived from the noise."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, Literal, TypeVar

import gymnasium
import numpy as np

from avrare.base.special_functions import uniform_from_normal as uniform
from avrare.protocols import Floats

Observation = TypeVar("Observation")

_FIXED = 0
"""Seed if every rollout has the same numbers."""


def bits(noise: Floats) -> int:
    """Return 128 bits that identify the numbers (a hash)."""
    digest = hashlib.blake2b(np.ascontiguousarray(noise).tobytes(), digest_size=16).digest()
    return int.from_bytes(digest, "little")


def reseed(generator: np.random.Generator, state: int) -> None:
    """Set the state of a PCG64 generator in place, since others may hold it too."""
    # any odd number: PCG64's streams differ by their state
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": state, "inc": 0x5851F42D4C957F2D14057B7EF767814F},
        "has_uint32": 0,
        "uinteger": 0,
    }


class TapeGenerator(np.random.Generator):
    """Generator that returns the numbers of a tape, transformed to the requested distribution.

    Normal, uniform and integer numbers come from the tape in the order of the draws; draws beyond it and
    from other distributions come from a generator seeded by the tape.
    """

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(_FIXED))
        self._left: list[float] = []

    def __reduce__(self) -> Any:
        return _tape_generator, (self.bit_generator.state, list(self._left))

    def load(self, noise: Floats) -> None:
        """Continue with these numbers."""
        reseed(self, bits(noise))
        self._left = noise[::-1].tolist()

    def standard_normal(self, size: Any = None, dtype: Any = np.float64, out: Any = None) -> Any:
        """Draw as ``numpy.random.Generator`` does."""
        if size is None and out is None:
            return self._left.pop() if self._left else super().standard_normal()
        shape = np.shape(out) if size is None else size
        count = int(np.prod(shape))
        numbers = [self._left.pop() for _ in range(min(count, len(self._left)))]
        rest = super().standard_normal(count - len(numbers))
        values = np.concatenate([numbers, rest]).reshape(shape).astype(dtype)
        if out is None:
            return values
        out[...] = values
        return out

    def random(self, size: Any = None, dtype: Any = np.float64, out: Any = None) -> Any:
        """Draw as ``numpy.random.Generator`` does."""
        normals = self.standard_normal(size if out is None else np.shape(out))
        values = _uniforms(normals)
        if out is None:
            return values if size is None else np.asarray(values).astype(dtype)[()]
        out[...] = values
        return out

    def normal(self, loc: Any = 0.0, scale: Any = 1.0, size: Any = None) -> Any:
        """Draw as ``numpy.random.Generator`` does."""
        return loc + scale * self.standard_normal(_shape(size, loc, scale))

    def uniform(self, low: object = 0.0, high: object = 1.0, size: object = None) -> Any:
        """Draw as ``numpy.random.Generator`` does."""
        return low + (np.asarray(high) - low)[()] * self.random(_shape(size, low, high))

    def integers(
        self,
        low: object,
        high: object = None,
        size: object = None,
        dtype: object = np.int64,
        endpoint: bool = False,
    ) -> Any:
        """Draw as ``numpy.random.Generator`` does."""
        low, high = (0, low) if high is None else (low, high)
        many = np.asarray(high) - low + bool(endpoint)
        drawn = np.minimum(np.floor(many * self.random(_shape(size, low, high))), many - 1)
        return (low + drawn).astype(dtype)[()]


def _shape(size: Any, first: Any, second: Any) -> Any:
    if size is not None or (np.ndim(first) == 0 and np.ndim(second) == 0):
        return size
    return np.broadcast_shapes(np.shape(first), np.shape(second))


def _uniforms(normals: Any) -> Any:
    if np.ndim(normals) == 0:
        return _below_one(float(normals))
    flat = [_below_one(float(z)) for z in np.ravel(normals)]
    return np.array(flat).reshape(np.shape(normals))


def _below_one(normal: float) -> float:
    return min(uniform(normal), 1.0 - 2.0**-53)


def _tape_generator(state: Mapping[str, object], left: list[float]) -> TapeGenerator:
    generator = TapeGenerator()
    generator.bit_generator.state = state
    generator._left = left
    return generator


class Stream:
    """Control of an environment's generator by the noise.

    Args:
        by: "seed", "tape", "none" or "free"; see ``avrare_gymnasium.config.StreamConfig``.
        at_steps: Also at every step, not only at the reset.
        numbers: Length of a tape.

    Attributes:
        noise_size: Noise numbers per reset and per step.
    """

    def __init__(
        self, by: Literal["seed", "tape", "none", "free"], at_steps: bool = True, numbers: int = 1
    ) -> None:
        self.by, self.at_steps = by, at_steps
        self.noise_size = {"seed": 1, "tape": numbers}.get(by, 0)

    def reset(
        self, env: gymnasium.Env[Observation, object], noise: Floats, options: dict[str, object] | None
    ) -> tuple[Observation, dict[str, Any]]:
        """Reset an environment with the first numbers of a row and return the result of its ``reset``."""
        noise = noise[: self.noise_size]
        if self.by == "tape":
            generator = env.unwrapped.np_random
            if not isinstance(generator, TapeGenerator):
                env.unwrapped.np_random = generator = TapeGenerator()
            generator.load(noise)
        seed = {"seed": lambda: bits(noise), "none": lambda: _FIXED}.get(self.by, lambda: None)()
        return env.reset(seed=seed, options=options)

    def step(self, env: gymnasium.Env[object, object], noise: Floats) -> None:
        """Set the generator before a step from the first numbers of a row."""
        if not self.at_steps or not self.noise_size:
            return
        noise = noise[: self.noise_size]
        generator = env.unwrapped.np_random
        if isinstance(generator, TapeGenerator):
            generator.load(noise)
        elif isinstance(generator.bit_generator, np.random.PCG64):
            reseed(generator, bits(noise))
        else:
            env.unwrapped.np_random = np.random.Generator(np.random.PCG64(bits(noise)))
