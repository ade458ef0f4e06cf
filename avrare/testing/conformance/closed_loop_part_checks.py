"""Checks of parts of a closed loop and of specifications on a batch of particles.

An exercise runs a part for a few steps, driven by a tape of numbers only. It is a generator
``play(part, tape, between)``: ``tape`` is (N, STEPS + 1, size) standard normal, ``between`` is applied to the
state of the part before every step, and it yields outputs, named arrays with leading axis N. All checks
compare such runs: the same tape twice, some of its rows, copied states.
"""

from __future__ import annotations

import pickle
import random
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.base.errors import AvrareError
from avrare.driving import Action, Observation, Prediction
from avrare.plugin.registry import default_registry
from avrare.protocols import (
    Controller,
    Floats,
    PerceptionErrorModel,
    Simulator,
    Specification,
    Tracker,
    overrides,
)
from avrare.stack.closed_loop import ClosedLoop
from avrare.testing.conformance import sample_traffic as road
from avrare.testing.conformance.suite import Skipped, Subject

STEPS = 5
_ROAD, _OTHERS = 4, 3
"""Numbers that place the traffic of one step, and vehicles other than the ego."""

Outputs = dict[str, Any]
Between = Callable[[Any], Any]
Play = Callable[[Any, Floats, Between], Iterator[Outputs]]


def _simulator(
    controller: Controller | None, misfit: str, part: Simulator, tape: Floats, between: Between
) -> Iterator[Outputs]:
    loop, world = ClosedLoop(part, controller=controller), part.reset(tape[:, 0])
    memory = controller.start(len(tape)) if controller is not None else None
    for step in range(STEPS + 1):
        if step and controller is not None:
            world = between(world)
            action, memory = controller.act(memory, loop.show(world), None)
            world = part.step(world, action, tape[:, step])
        elif step:
            world = _step_world(part, between(world), tape[:, step], misfit)
        yield _name_values(step, part.signals(world)) | _features(part, world, step)


def _step_world(part: Simulator, world: object, noise: Floats, misfit: str) -> object:
    # straight on if there is an ego, without an action in other simulators
    action = Action(np.zeros(len(noise)), np.zeros(len(noise))) if part.scene else None
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
    raise Skipped(f"it needs an action, which only its own controller knows: {reason}{misfit}")


class _ActionRead(Exception):
    """Raised when a probe in place of an action is read."""


def _report(*_: object) -> object:
    raise _ActionRead


class _ActionProbe:
    """Placeholder for an action; any use of it raises ``_ActionRead``."""

    __getattr__ = __getitem__ = __iter__ = __len__ = __array__ = __float__ = _report
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __neg__ = _report


def _reads_its_action(part: Simulator, world: object, noise: Floats) -> bool:
    # a step that fails on None without reading it has a fault
    try:
        part.step(world, _ActionProbe(), noise)
    except _ActionRead:
        return True
    except Exception:
        return False
    return False


def _perception(part: PerceptionErrorModel, tape: Floats, between: Between) -> Iterator[Outputs]:
    lasting = overrides(part, PerceptionErrorModel.follow)
    memory = part.start(tape[:, 0, _ROAD:]) if lasting else None
    for step in range(STEPS + 1):
        world, noise = between(road.world(tape[:, step, :_ROAD], step)), tape[:, step, _ROAD:]
        observation = part.observe(world, noise)
        yield _name_values(step, vars(observation))
        if lasting and step:
            followed, memory = part.follow(world, noise, between(memory))
            yield {f"followed {name}": value for name, value in _name_values(step, vars(followed)).items()}
        if overrides(part, PerceptionErrorModel.log_prob):
            yield {f"log_prob at {step}": part.log_prob(world, observation)}


def _tracker(part: Tracker, tape: Floats, between: Between) -> Iterator[Outputs]:
    track = part.start(road.world(tape[:, 0, :_ROAD], 0))
    for step in range(STEPS + 1):
        if step:
            track = part.update(between(track), _observation(tape[:, step], step))
        yield _name_values(step, vars(part.predict(track, 3))) | _features(part, track, step)


def _features(part: Simulator | Tracker | Controller, state: object, step: int) -> Outputs:
    # What a part declares for learning must be as good as what it gives to others.
    declared = part.features(state)
    return {} if declared is None else {f"features at step {step}": declared}


def _observation(numbers: Floats, step: int) -> Observation:
    # errors of half a metre; every sixth vehicle is missed
    others = road.world(numbers[:, :_ROAD], step).others
    detected = numbers[:, -_OTHERS:] > -1.0
    x, y, speed = (np.where(detected, value, np.nan) for value in (others.x, others.y, others.speed))
    return Observation(detected, x, y, speed)


def _controller(part: Controller, tape: Floats, between: Between) -> Iterator[Outputs]:
    memory = part.start(len(tape))
    ahead = 0.2 * np.arange(part.horizon + 1)
    for step in range(STEPS + 1):
        world = road.world(tape[:, step], step)
        x = world.others.x[..., None] + world.others.speed[..., None] * ahead
        prediction = Prediction(x, np.broadcast_to(world.others.y[..., None], x.shape))
        action, memory = part.act(between(memory), world.ego, prediction)
        yield _name_values(step, vars(action)) | _features(part, memory, step)


def _plain_controller(part: Controller, tape: Floats, between: Between) -> Iterator[Outputs]:
    memory = part.start(len(tape))
    for step in range(STEPS + 1):
        action, memory = part.act(between(memory), tape[:, step], None)
        yield {f"action at step {step}": action}


def _observation_size(part: Controller) -> int:
    """Return the count of numbers that a controller without vehicles takes, by trying."""
    reason = ""
    most_numbers = 64
    for size in range(1, most_numbers + 1):
        try:
            part.act(part.start(2), np.zeros((2, size)), None)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            continue
        return size
    raise Skipped(f"no observation of 1 to {most_numbers} numbers fits it: {reason}")


def _specification(part: Specification, tape: Floats, between: Between) -> Iterator[Outputs]:
    state = part.start(len(tape))
    for step in range(STEPS + 1):
        signals = _AnySignals(tape[:, step], step)
        state, verdict = part.update(between(state), signals)
        yield _name_values(step, vars(verdict))


class _AnySignals(Mapping[str, NDArray[Any]]):
    """Signals of the traffic, and a wave (N,) under any other name."""

    def __init__(self, numbers: Floats, step: int) -> None:
        self._numbers, self._step = numbers, step
        self._traffic = road.signals(road.world(numbers, step))

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name in self._traffic:
            return self._traffic[name]
        column = zlib.crc32(name.encode()) % self._numbers.shape[1]
        wave: Floats = np.sin(0.7 * self._step) + self._numbers[:, column]
        return wave

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str)

    def __iter__(self) -> Iterator[str]:
        return iter(self._traffic)

    def __len__(self) -> int:
        return len(self._traffic)


def _name_values(step: int, values: Mapping[str, object]) -> Outputs:
    return {f"{name} at step {step}": value for name, value in values.items() if value is not None}


_EXERCISES: dict[str, tuple[Play, Callable[[Any], int]]] = {
    "simulator": (partial(_simulator, None, ""), lambda part: int(part.noise_size)),
    "perception": (_perception, lambda part: _ROAD + int(part.noise_size)),
    "tracker": (_tracker, lambda part: _ROAD + _OTHERS),
    "controller": (_controller, lambda part: _ROAD),
    "specification": (_specification, lambda part: _ROAD),
}
"""Exercise of each kind, and the count of numbers that a part reads at a step."""


def _find_controller(subject: Subject, simulator: Simulator) -> tuple[Controller | None, str]:
    """Return the first controller of a simulator's package that can steer it, else None and why it cannot."""
    reason, noise = "", np.zeros((2, simulator.noise_size))
    rows = [row for row in default_registry().rows() if row.distribution == subject.row.distribution]
    for row in sorted(rows, key=lambda row: row.name != subject.name):
        if row.kind != "controller":
            continue
        try:
            controller: Controller = Subject(row).build()
            loop = ClosedLoop(simulator, controller=controller)
            loop.step(loop.initial(noise), noise)
        except Exception as error:
            reason = f"; its package's controller {row.name!r} does not fit: {type(error).__name__}: {error}"
            continue
        return controller, ""
    return None, reason


class Exercise:
    """A built part and its exercise.

    Raises:
        Skipped: The part cannot be built here, or its inputs are unknown.
    """

    rows = 7

    def __init__(self, subject: Subject) -> None:
        if subject.kind not in _EXERCISES:
            raise Skipped(f"a part of kind {subject.kind} has no states")
        self._play, size = _EXERCISES[subject.kind]
        if subject.kind == "controller" and not subject.component.driving:
            self._play, size = _plain_controller, _observation_size
        self._part = subject.build()
        if subject.kind == "simulator" and self._part.scene is None:
            self._play = partial(_simulator, *_find_controller(subject, self._part))
        self.tape = np.random.default_rng(1).standard_normal((self.rows, STEPS + 1, size(self._part)))
        self.outputs = self.play(self.tape)

    def play(self, tape: Floats, between: Between = lambda state: state) -> Outputs:
        """Return the outputs for a tape (N, STEPS + 1, size)."""
        return dict(output for some in self._play(self._part, tape, between) for output in some.items())


def split_and_join(state: object) -> object:
    """Take a state apart and join it, as the splitting estimators do."""
    if not batch.leaves(state):
        return state
    half = batch.size(state) // 2
    first, rest = np.arange(half), np.arange(half, batch.size(state))
    return batch.concatenate([batch.take(state, first), batch.take(state, rest)])


def read_only(state: object) -> object:
    """Return a copy that cannot be written to."""
    copy = batch.separate_leaves(state)
    for leaf in batch.leaves(copy):
        leaf.flags.writeable = False
    return copy


def outputs_are_rows(subject: Subject) -> None:
    """Every output is an array with one entry per particle."""
    exercise = Exercise(subject)
    for name, value in exercise.outputs.items():
        assert isinstance(value, np.ndarray), f"{name} is a {type(value).__name__}, not an array"
        shape, n = value.shape, exercise.rows
        assert shape[:1] == (n,), f"{name} has shape {shape} for {n} particles"


def same_noise_same_bits(subject: Subject) -> None:
    """The same noise gives the same bits, the second time and from a new part."""
    exercise, other = Exercise(subject), Exercise(subject)
    _compare(exercise.outputs, exercise.play(exercise.tape), "the second time")
    _compare(exercise.outputs, other.outputs, "from a new part")


def draws_no_numbers_of_its_own(subject: Subject) -> None:
    """The global random generators of Python and NumPy are not used."""
    before = _generators()
    Exercise(subject)
    assert before == _generators(), "it draws from a global generator; derive all choices from the noise"


def rows_are_independent(subject: Subject) -> None:
    """The outputs of a particle are the same, bit for bit, whatever the rest of the batch."""
    exercise = Exercise(subject)
    for rows in ([2], [5, 0], [6, 4, 3, 1]):
        outputs = exercise.play(exercise.tape[rows])
        _compare(batch.take(exercise.outputs, np.array(rows)), outputs, f"rows {rows} without the others")


def states_can_be_copied(subject: Subject) -> None:
    """Splitting and joining a state between steps changes no bit."""
    exercise = Exercise(subject)
    _compare(exercise.outputs, exercise.play(exercise.tape, split_and_join), "with copied states")


def states_are_values(subject: Subject) -> None:
    """A step does not modify the state that it starts from."""
    exercise = Exercise(subject)
    _compare(exercise.outputs, exercise.play(exercise.tape, read_only), "with read-only states")


def nan_stays_in_its_row(subject: Subject) -> None:
    """A NaN in one particle raises nothing and does not affect the others."""
    exercise = Exercise(subject)
    if exercise.tape.shape[2] == 0:
        return
    tape = exercise.tape.copy()
    tape[0, 1:] = np.nan
    with np.errstate(all="ignore"):
        outputs = exercise.play(tape)
    others = np.arange(1, exercise.rows)
    _compare(batch.take(exercise.outputs, others), batch.take(outputs, others), "beside a row of NaN")


def _generators() -> bytes:
    return pickle.dumps((random.getstate(), np.random.get_state()))


def _compare(wanted: Outputs, outputs: Outputs, when: str) -> None:
    assert list(wanted) == list(outputs), f"different outputs {when}: {sorted(set(wanted) ^ set(outputs))}"
    for name, value in wanted.items():
        equal = np.array_equal(value, outputs[name], equal_nan=value.dtype.kind == "f")
        assert equal, f"{name} differs {when}"


CHECKS: tuple[Callable[[Subject], None], ...] = (
    outputs_are_rows,
    same_noise_same_bits,
    draws_no_numbers_of_its_own,
    rows_are_independent,
    states_can_be_copied,
    states_are_values,
    nan_stays_in_its_row,
)
