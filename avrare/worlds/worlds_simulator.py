"""Simulator of N worlds that are advanced one at a time, and its system with a controller.

Values that are drawn for each rollout travel at the end of the rows of noise, as zeros after the reset: so
they are part of the inputs from which a world is replayed, and a world in another process gets the same ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.base.errors import UsageError, did_you_mean
from avrare.protocols import Controller, Floats, Signals, Simulator, System, adapt, overrides
from avrare.worlds.step_timeout import Watchdog
from avrare.worlds.world import Copy, World, choose_readout, close
from avrare.worlds.world_histories import Branches, InputHistory, WorldPool

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True)
class WorldState:
    """State of N worlds: inputs and outcomes; the worlds themselves stay in their process.

    Attributes:
        step: (N,) number of steps since the reset.
        track: (N,) input histories, whose first ``step`` steps lead to the row's state.
        signals: Signals (N, ...) by name.
        seen: (N, d) observations.
        replayed: (N,) number of steps that were replayed to reach the state of a branch; 0 with copies.
    """

    step: NDArray[np.int64]
    track: NDArray[Any]
    signals: dict[str, Floats]
    seen: Floats
    replayed: NDArray[np.int64]

    @property
    def ego(self) -> Floats:
        """Observations, which a controller acts on."""
        return self.seen


class Worlds(Simulator):
    """Simulator of worlds that ``make`` creates.

    A row that branches gets a world of its own. With ``replay`` it is reset and the same inputs are replayed.
    With ``deepcopy`` or ``hook`` (the world's own ``snapshot`` and ``restore``) it continues from a copy of
    the state at the branch; a process that has no copy yet replays the inputs first. The outcome is the same
    for every choice and any number of processes.

    Args:
        make: Creates a world, such as its class; must survive pickling to be used in worker processes.
        dt: Duration of a step [s]; formulas in seconds use it.
        copy: "replay", "deepcopy" or "hook".
        step_timeout: Wall-clock seconds after which a reset or a step is an error of its rollout; None: no
            limit. Choose it large enough that only a step that hangs exceeds it.
        reuse: Reset a world for the next rollout; else each rollout gets a new one.

    Attributes:
        noise_size: Number of noise values of a world.
        noise_names: Their names, if the worlds declare any.
        lacks: Reasons by missing capability (``avrare.worlds.capabilities``), as the worlds declare.

    Raises:
        UsageError: An argument is invalid.
    """

    def __init__(
        self,
        make: Callable[[], object],
        *,
        dt: float = 1.0,
        copy: Copy = "replay",
        step_timeout: float | None = None,
        reuse: bool = True,
    ) -> None:
        if copy not in get_args(Copy):
            raise UsageError(
                f"copy must be one of {', '.join(get_args(Copy))}, not {copy!r}",
                did_you_mean(copy, get_args(Copy)),
            )
        if not callable(make):
            raise UsageError(
                f"worlds are created by a class or a function, not by a {type(make).__name__} object",
                f"pass the class: {type(make).__name__}, not {type(make).__name__}()",
            )
        if step_timeout is not None and not 0.0 < step_timeout < 1e6:
            raise UsageError(f"step_timeout must be a positive number of seconds, not {step_timeout!r}")
        self._again = partial(type(self), make, dt=dt, copy=copy, step_timeout=step_timeout, reuse=reuse)
        self.dt = dt
        self._pool = WorldPool(make, copy, reuse)
        self._watchdog = Watchdog(step_timeout)
        first = _check_world(make(), copy)
        self.noise_size, self.noise_names = int(first.noise_size), first.noise_names
        self.lacks = first.lacks
        self._prepare = first.prepare
        self._readout = choose_readout(first)
        self._branches = Branches(self._pool, self._watchdog, self._readout)
        self._pool.return_world(first)

    def __reduce__(self) -> tuple[object, ...]:
        return self._again, ()

    def reset(self, noise: Floats) -> WorldState:
        """Return worlds at t = 0 from noise (N, noise_size)."""
        self._pool.recall(len(noise), keep=())
        with self._watchdog:
            histories = [self._start(row) for row in _freeze(noise)]
        zeros = np.zeros(len(noise), dtype=np.int64)
        return self._state(zeros, histories, zeros)

    def step(self, world: WorldState, action: object, noise: Floats) -> WorldState:
        """Return worlds one step later; ``action`` is an array with leading axis N, or None.

        Raises:
            NotDeterministic: The same inputs do not bring a world to the same state.
        """
        action = self._prepare(action, noise)
        at, histories = world.step.tolist(), world.track.tolist()
        inputs = list(zip(_rows(action, len(at)), _freeze(noise), strict=True))
        replayed, recalled = world.replayed.copy(), False
        with self._watchdog:
            for i, (history, t, step_input) in enumerate(zip(histories, at, inputs, strict=True)):
                if history.world is None or len(history.actions) != t:
                    if history.ended_with(t, *step_input):
                        if history.fault is not None:
                            raise history.fault
                        continue
                    if not recalled:
                        self._recall_worlds(histories, at, inputs)
                        recalled = True
                    replayed[i] += t if len(history.actions) > t and self._pool.copying == "replay" else 0
                    signals = batch.take(world.signals, slice(i, i + 1))
                    histories[i] = history = self._branches.branch(history, t, signals)
                self._advance(history, *step_input)
                if self._branches.untested and t in history.copies:
                    self._branches.test_copy(history, t, step_input)
        return self._state(world.step + 1, histories, replayed)

    def signals(self, world: WorldState) -> Signals:
        """Return the signals of the worlds, (N, ...) each."""
        return world.signals

    def counts(self, world: WorldState) -> dict[str, NDArray[np.int64]]:
        """Return ``replayed_steps`` (N,): see ``WorldState``."""
        return {"replayed_steps": world.replayed} if self._pool.copying == "replay" else {}

    def _recall_worlds(
        self, histories: list[InputHistory], at: list[int], inputs: list[tuple[object, Floats]]
    ) -> None:
        settled = [
            history
            for history, t, step_input in zip(histories, at, inputs, strict=True)
            if (history.world is not None and len(history.actions) == t) or history.ended_with(t, *step_input)
        ]
        self._pool.recall(len(histories) - len(settled), set(settled))

    def _start(self, noise: Floats) -> InputHistory:
        history = InputHistory([noise], [])
        try:
            world = self._pool.take_world(history)
            self._watchdog.call(world.reset, noise)
            history.latest = self._watchdog.call(self._readout.read_world, world)
        except (Exception, SystemExit) as error:
            raise self._record_fault(history, error) from error
        return history

    def _advance(self, history: InputHistory, action: object, noise: Floats) -> None:
        # Advance by one step; an exception is stored, and the step is not tried again.
        history.latest = None
        history.actions.append(action)
        history.noise.append(noise)
        world: Any = history.world
        try:
            if self._watchdog.seconds is None:  # saves two of the few calls per step
                world.step(action, noise)
                history.latest = self._readout.read_world(world)
            else:
                self._watchdog.call(world.step, action, noise)
                history.latest = self._watchdog.call(self._readout.read_world, world)
        except (Exception, SystemExit) as error:
            raise self._record_fault(history, error) from error

    def _record_fault(self, history: InputHistory, error: BaseException) -> Exception:
        self._pool.discard(history)
        history.fault = error if isinstance(error, Exception) else RuntimeError(f"the world exits: {error}")
        return history.fault

    def _state(
        self, step: NDArray[np.int64], histories: list[InputHistory], replayed: NDArray[np.int64]
    ) -> WorldState:
        column = np.empty(len(histories), dtype=object)
        column[:] = histories
        signals, observations = self._readout.stack([history.latest for history in histories])
        return WorldState(step, column, signals, observations, replayed)


def _rows(action: object, n: int) -> Iterable[object]:
    if action is None:
        return [None] * n
    if not isinstance(action, np.ndarray) or action.shape[:1] != (n,):
        shape = f" of shape {action.shape}" if isinstance(action, np.ndarray) else ""
        raise UsageError(
            f"the controller returned {type(action).__name__}{shape}, but every world takes its own row",
            f"a controller for this simulator returns an array with leading axis {n}",
        )
    return iter(_freeze(action))


def _freeze(values: NDArray[Scalar]) -> NDArray[Scalar]:
    # Histories hold views of the rows, which must not change.
    view = values.view()
    view.flags.writeable = False
    return view


def _check_world(made: object, copy: Copy) -> World:
    world = adapt(World, made)
    if copy == "hook" and not (overrides(world, World.snapshot) and overrides(world, World.restore)):
        raise UsageError(
            f"{type(world).__name__} lacks snapshot, restore: copy: hook calls them",
            "copy: replay needs only that the same noise gives the same rollout",
        )
    return world


@dataclass(frozen=True)
class LoopState:
    """State of the worlds and memory of their controller."""

    world: WorldState
    memory: Any


class WorldSystem(System):
    """System of worlds under an optional controller.

    Args:
        worlds: Simulator.
        controller: ``start(n) -> memory`` and ``act(memory, seen, None) -> (action, memory)``, where ``seen``
            is (N, d) and ``action`` has leading axis N; None: the worlds get the action None.
    """

    def __init__(self, worlds: Worlds, controller: object = None) -> None:
        self.worlds, self.dt, self.lacks = worlds, worlds.dt, worlds.lacks
        self.controller = None if controller is None else adapt(Controller, controller)
        self.noise_size = worlds.noise_size

    def initial(self, noise: Floats) -> LoopState:
        """Return the state at t = 0 from noise (N, noise_size)."""
        memory = self.controller.start(len(noise)) if self.controller is not None else None
        return LoopState(self.worlds.reset(noise), memory)

    def step(self, state: LoopState, noise: Floats) -> LoopState:
        """Return the state one step later."""
        action, memory = None, None
        if self.controller is not None:
            action, memory = self.controller.act(state.memory, state.world.seen, None)
        return LoopState(self.worlds.step(state.world, action, noise), memory)

    def signals(self, state: LoopState) -> Signals:
        """Return the signals of the worlds."""
        return self.worlds.signals(state.world)

    def counts(self, state: LoopState) -> dict[str, NDArray[np.int64]]:
        """Return the counters of the worlds and of the controller."""
        counts = self.controller.counts(state.memory) if self.controller is not None else {}
        return {**self.worlds.counts(state.world), **counts}


def as_system(
    make: Callable[[], object],
    controller: object = None,
    *,
    copy: Copy = "replay",
    step_timeout: float | None = None,
    reuse: bool = True,
) -> WorldSystem:
    """Return the system of worlds that ``make`` creates; see ``Worlds`` and ``WorldSystem``."""
    return WorldSystem(Worlds(make, copy=copy, step_timeout=step_timeout, reuse=reuse), controller)


class DrawnWorlds(Worlds):
    """Simulator of worlds that take values (``World.assign``) in place of drawn options.

    Args:
        make: Creates a world.
        names: Places of the options that are drawn, in the order of their numbers.
        options: As of ``Worlds``.
    """

    def __init__(self, make: Callable[[], World], names: Sequence[str] = (), **options: Any) -> None:
        super().__init__(partial(_Valued, make, tuple(names)) if names else make, **options)
        self._plain, self._names = (make, options), tuple(names)
        self.noise_size -= len(self._names)
        if self.noise_names is not None:
            self.noise_names = self.noise_names[: self.noise_size]

    def __reduce__(self) -> tuple[object, ...]:
        make, options = self._plain
        return partial(type(self), make, self._names, **options), ()

    def drawing(self, laws: Mapping[str, object]) -> DrawnWorlds:
        """Return the same simulator for draws of options by these laws."""
        make, options = self._plain
        return type(self)(make, tuple(laws), **options)

    def reset_drawn(self, noise: Floats, values: Mapping[str, Floats]) -> WorldState:
        """Return the worlds at t = 0 with drawn values (N,)."""
        return super().reset(np.column_stack([noise, *(values[name] for name in self._names)]))

    def step(self, world: WorldState, action: object, noise: Floats) -> WorldState:
        """Return worlds one step later; ``action`` is an array with leading axis N, or None."""
        return super().step(world, action, np.pad(noise, ((0, 0), (0, len(self._names)))))


class _Valued(World):
    # World whose rows of noise end with the values of its options.

    def __init__(self, make: Callable[[], World], names: tuple[str, ...]) -> None:
        self.world, self._names = adapt(World, make()), names
        self._own = int(self.world.noise_size)
        self.noise_size = self._own + len(names)
        if self.world.noise_names is not None:
            self.noise_names = (*self.world.noise_names, *names)
        self.lacks, self.has_table = self.world.lacks, self.world.has_table

    def reset(self, noise: Floats) -> None:
        self.world.assign(dict(zip(self._names, noise[self._own :].tolist(), strict=True)))
        self.world.reset(noise[: self._own])

    def prepare(self, actions: object, noise: Floats) -> Any:
        return self.world.prepare(actions, noise[:, : self._own])

    def step(self, action: object, noise: Floats) -> None:
        self.world.step(action, noise[: self._own])

    def signals(self) -> Mapping[str, object]:
        return self.world.signals()

    def observation(self) -> Any:
        return self.world.observation()

    def numbers(self) -> Any:
        return self.world.numbers()

    def split_table(self, table: Floats) -> tuple[dict[str, Floats], Floats]:
        return self.world.split_table(table)

    def snapshot(self) -> object:
        return self.world.snapshot()

    def restore(self, snapshot: object) -> None:
        self.world.restore(snapshot)

    def close(self) -> None:
        close(self.world)
