"""How a part of each kind is put through a few steps, from nothing but a tape of numbers.

A drill is a function ``play(part, tape, between) -> outputs``: ``tape`` is (N, STEPS + 1, size) standard
normal, ``between`` is applied to the part's state before every step, ``outputs`` are named arrays with
leading axis N. All checks of behaviour are made of that: the same tape twice, some of its rows, a state that
was copied.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from avrare import batch
from avrare.authors import road
from avrare.authors.outcome import Skipped
from avrare.authors.subject import Subject
from avrare.driving import Action, Observation, Prediction
from avrare.errors import AvrareError
from avrare.protocols import Floats, PersistentPerceptionErrorModel

STEPS = 5
_ROAD, _OTHERS = 4, 3
"""Numbers that place the traffic of one step, and vehicles beside the ego."""

Outputs = dict[str, Any]
Between = Callable[[Any], Any]
Drill = Callable[[Any, Floats, Between], Outputs]


def drill_of(subject: Subject) -> tuple[Drill, Callable[[Any], int]]:
    """The drill of a component's kind, and the numbers that it reads at a step, from the part.

    Raises:
        Skipped: Nothing is known of what the part is handed.
    """
    if subject.kind not in _DRILLS:
        raise Skipped(f"a part of kind {subject.kind} has no states")
    if subject.kind == "controller" and not subject.component.driving:
        raise Skipped("not made for driving: what it sees is known to its own simulator only")
    return _DRILLS[subject.kind]


def _simulator(part: Any, tape: Floats, between: Between) -> Outputs:
    outputs: Outputs = {}
    world = part.reset(tape[:, 0])
    for step in range(STEPS + 1):
        if step:
            world = _stepped(part, between(world), tape[:, step])
        outputs |= _named(step, part.signals(world))
    return outputs


def _stepped(part: Any, world: Any, noise: Floats) -> Any:
    """One step on: straight on, for what has an ego; other simulators act by themselves here.

    Raises:
        Skipped: It wants an action, and only its own controller knows which.
    """
    action = Action(np.zeros(len(noise)), np.zeros(len(noise))) if hasattr(part, "scene") else None
    try:
        return part.step(world, action, noise)
    except AvrareError as error:
        wants = "action" in error.message or "controller" in error.message
        reason = error.message
        if not wants:
            raise
    except (TypeError, AttributeError) as error:
        reason = str(error)
        if action is not None or not _reads_its_action(part, world, noise):
            raise
    raise Skipped(f"it wants an action, which only its own controller knows: {reason}")


class _Read(Exception):
    """Somebody has looked at an action."""


def _tell(*_: Any) -> Any:
    raise _Read


class _Alarm:
    """Stands for an action; whatever is done with it raises ``_Read``."""

    __getattr__ = __getitem__ = __iter__ = __len__ = __array__ = __float__ = _tell
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __neg__ = _tell


def _reads_its_action(part: Any, world: Any, noise: Floats) -> bool:
    """Whether a step looks at the action at all: one that fails on None without looking has a fault."""
    try:
        part.step(world, _Alarm(), noise)
    except _Read:
        return True
    except Exception:
        return False
    return False


def _perception(part: Any, tape: Floats, between: Between) -> Outputs:
    outputs: Outputs = {}
    lasting = isinstance(part, PersistentPerceptionErrorModel)
    memory = part.start(tape[:, 0, _ROAD:]) if lasting else None
    for step in range(STEPS + 1):
        world, noise = between(road.world(tape[:, step, :_ROAD], step)), tape[:, step, _ROAD:]
        observation = part.observe(world, noise)
        outputs |= _named(step, vars(observation))
        if lasting and step:
            followed, memory = part.follow(world, noise, between(memory))
            outputs |= {f"followed {name}": value for name, value in _named(step, vars(followed)).items()}
        if hasattr(part, "log_prob"):
            outputs[f"log_prob at {step}"] = part.log_prob(world, observation)
    return outputs


def _tracker(part: Any, tape: Floats, between: Between) -> Outputs:
    outputs: Outputs = {}
    track = part.start(road.world(tape[:, 0, :_ROAD], 0))
    for step in range(STEPS + 1):
        if step:
            track = part.update(between(track), _observation(tape[:, step], step))
        outputs |= _named(step, vars(part.predict(track, 3)))
    return outputs


def _observation(numbers: Floats, step: int) -> Observation:
    """Of the traffic, half a metre off, with every sixth vehicle missed."""
    others = road.world(numbers[:, :_ROAD], step).others
    detected = numbers[:, -_OTHERS:] > -1.0
    x, y, speed = (np.where(detected, value, np.nan) for value in (others.x, others.y, others.speed))
    return Observation(detected, x, y, speed)


def _controller(part: Any, tape: Floats, between: Between) -> Outputs:
    outputs: Outputs = {}
    memory = part.start(len(tape))
    ahead = 0.2 * np.arange(part.horizon + 1)
    for step in range(STEPS + 1):
        world = road.world(tape[:, step], step)
        x = world.others.x[..., None] + world.others.speed[..., None] * ahead
        prediction = Prediction(x, np.broadcast_to(world.others.y[..., None], x.shape))
        action, memory = part.act(between(memory), world.ego, prediction)
        outputs |= _named(step, vars(action))
    return outputs


def _specification(part: Any, tape: Floats, between: Between) -> Outputs:
    outputs: Outputs = {}
    state = part.start(len(tape))
    for step in range(STEPS + 1):
        signals = _AnySignals(tape[:, step], step)
        state, verdict = part.update(between(state), signals)
        outputs |= _named(step, vars(verdict))
    return outputs


class _AnySignals(Mapping[str, Any]):
    """The signals of the traffic, and a wave (N,) under any other name."""

    def __init__(self, numbers: Floats, step: int) -> None:
        self._numbers, self._step = numbers, step
        self._traffic = road.signals(road.world(numbers, step))

    def __getitem__(self, name: str) -> Any:
        if name in self._traffic:
            return self._traffic[name]
        column = zlib.crc32(name.encode()) % self._numbers.shape[1]
        return np.sin(0.7 * self._step) + self._numbers[:, column]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str)

    def __iter__(self) -> Iterator[str]:
        return iter(self._traffic)

    def __len__(self) -> int:
        return len(self._traffic)


def _named(step: int, values: Mapping[str, Any]) -> Outputs:
    return {f"{name} at step {step}": value for name, value in values.items()}


_DRILLS: dict[str, tuple[Drill, Callable[[Any], int]]] = {
    "simulator": (_simulator, lambda part: int(part.noise_size)),
    "perception": (_perception, lambda part: _ROAD + int(part.noise_size)),
    "tracker": (_tracker, lambda part: _ROAD + _OTHERS),
    "controller": (_controller, lambda part: _ROAD),
    "specification": (_specification, lambda part: _ROAD),
}


def same(state: Any) -> Any:
    """Leaves a state as it is."""
    return state


class Exercise:
    """A built part and its drill.

    Raises:
        Skipped: It cannot be built here, or wants an action that only its own controller knows.
    """

    rows = 7

    def __init__(self, subject: Subject) -> None:
        self._play, size = drill_of(subject)
        self._part = subject.build()
        self.tape = np.random.default_rng(1).standard_normal((self.rows, STEPS + 1, size(self._part)))
        self.outputs = self.play(self.tape)

    def play(self, tape: Floats, between: Between = same) -> Outputs:
        """The outputs for a tape (N, STEPS + 1, size)."""
        return self._play(self._part, tape, between)


def copied(state: Any) -> Any:
    """The same rows, taken apart and joined again: what splitting does to a state."""
    if not batch.leaves(state):
        return state
    half = batch.size(state) // 2
    first, rest = np.arange(half), np.arange(half, batch.size(state))
    return batch.concatenate([batch.take(state, first), batch.take(state, rest)])


def frozen(state: Any) -> Any:
    """A copy that cannot be written to."""
    own = batch.separated(state)
    for leaf in batch.leaves(own):
        leaf.flags.writeable = False
    return own
