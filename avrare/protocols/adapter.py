"""Defaults for parts of plain classes, and systems around other systems."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MethodType
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.protocols import kinds
from avrare.protocols.kinds import System
from avrare.protocols.values import Bools, Floats, Misreading, Signals

BASES: dict[str, type[Any]] = {
    "simulator": kinds.Simulator,
    "perception": kinds.PerceptionErrorModel,
    "tracker": kinds.Tracker,
    "controller": kinds.Controller,
    "specification": kinds.Specification,
    "estimator": kinds.Estimator,
    "executor": kinds.Executor,
}
"""Base class of each kind of part."""

BaseT = TypeVar("BaseT")


def adapt(base: type[BaseT], part: object) -> BaseT:
    """Return a part with the defaults of a base class; a part of a class derived from it as it is.

    Raises:
        UsageError: The part lacks a member that has no default, or is a class.
    """
    kind = re.sub("(?<=.)([A-Z])", r" \1", base.__name__).lower()
    if isinstance(part, type):
        name = part.__name__
        raise UsageError(f"{name} is a class, not a {kind}", f"give an object of it, such as {name}()")
    if missing := list_missing_members(base, part):
        members = [_describe_member(base, member) for member in required_members(base)]
        raise UsageError(
            f"{type(part).__name__} is not a valid {kind}: it lacks {', '.join(missing)}",
            f"a {kind} has {', '.join(members[:-1])} and {members[-1]}",
        )
    if isinstance(part, base) or (isinstance(part, Adapted) and part.base is base):
        return cast("BaseT", part)
    return cast("BaseT", _adapted_class(type(part).__qualname__)(part, base))


@functools.cache
def _adapted_class(name: str) -> type[Adapted]:
    # It has the name of the part's class: errors and journals show it.
    return type(name.rpartition(".")[2], (Adapted,), {"__qualname__": name})


@dataclass(eq=False)
class Adapted:
    """Part of a plain class, with the defaults of ``base``. A member that is None counts as absent."""

    part: Any
    base: type[Any]

    def __reduce__(self) -> tuple[object, ...]:
        return adapt, (self.base, self.part)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if not hasattr(self.base, name) or not _lacks(self.part, name):
            return getattr(self.part, name)
        default = inspect.getattr_static(self.base, name)
        return default.__get__(self) if hasattr(default, "__get__") else default


def required_members(base: type[Any]) -> list[str]:
    """Return the members of a base class that have no default."""
    classes = base.__mro__[::-1]
    values = [name for cls in classes for name in inspect.get_annotations(cls) if not hasattr(base, name)]
    methods = [name for cls in classes for name in vars(cls) if name in base.__abstractmethods__]
    return list(dict.fromkeys([*values, *methods]))


def list_missing_members(base: type[object], part: object) -> list[str]:
    """Return the members without a default that a part lacks, or has as None."""
    return [name for name in required_members(base) if _lacks(part, name)]


def _lacks(part: object, name: str) -> bool:
    try:
        return getattr(part, name) is None
    except AttributeError:
        if inspect.getattr_static(part, name, None) is not None:
            raise  # from within a property
        return True


def overrides(part: object, default: Callable[..., object]) -> bool:
    """Return whether a part overrides the method ``default`` of its base class."""
    method = getattr(part, default.__name__)
    return not isinstance(method, MethodType) or method.__func__ is not default


def _describe_member(base: type[object], name: str) -> str:
    if not hasattr(base, name):
        return name
    return f"{name}({', '.join(list(inspect.signature(getattr(base, name)).parameters)[1:])})"


class SystemWrapper(System):
    """System around another one; a subclass overrides what it changes.

    Attributes:
        system: The other system.
    """

    def __init__(self, system: object) -> None:
        self.system = system = adapt(System, system)
        self.noise_size, self.noise_names = system.noise_size, system.noise_names
        self.perfect_noise, self.dt, self.scene = system.perfect_noise, system.dt, system.scene
        self.lacks, self.warnings = system.lacks, system.warnings

    def unwrap(self, state: Any) -> Any:
        """Return the state of the other system. Default: the same."""
        return state

    def check_steps(self, steps: int) -> None:
        """Raise the ``UsageError`` of the other system."""
        self.system.check_steps(steps)

    def initial(self, noise: Floats) -> Any:
        """Return the state of the other system at t = 0."""
        return self.system.initial(noise)

    def step(self, state: Any, noise: Floats) -> Any:
        """Return the state of the other system one step later."""
        return self.system.step(state, noise)

    def signals(self, state: Any) -> Signals:
        """Return the signals of the other system."""
        return self.system.signals(self.unwrap(state))

    def faults(self, state: Any) -> Bools | None:
        """Return the rows (N,) of the other system that have broken down."""
        return self.system.faults(self.unwrap(state))

    def ended(self, state: object) -> Bools | None:
        """Return the rows (N,) of the other system that have ended: no later sample counts."""
        return self.system.ended(self.unwrap(state))

    def counts(self, state: Any) -> Mapping[str, NDArray[np.int64]]:
        """Return the counters of the other system."""
        return self.system.counts(self.unwrap(state))

    def misreadings(self, state: object) -> Mapping[str, Misreading]:
        """Return the misreadings of the other system."""
        return self.system.misreadings(self.unwrap(state))

    def features(self, state: object) -> Floats | None:
        """Return the features of the other system."""
        return self.system.features(self.unwrap(state))
