"""Systems for tests: odd containers of state and errors of every kind; worker processes can import them."""

import ctypes
import multiprocessing
import os
import resource
import signal
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from avrare.protocols import Floats
from avrare.rollout import engine
from avrare.testing.faulty_systems import Counting, Fragile, Walk
from avrare.worlds.capabilities import STEPS, probe
from plain_systems import Still


@dataclass(frozen=True)
class Inner:
    """Part of ``Nested``."""

    x: Floats


@dataclass(frozen=True)
class Nested:
    """State with every allowed container, and values that all particles share."""

    inner: Inner
    pair: tuple[Floats, Floats]
    label: str = "car"
    nothing: None = None


class NestedWalk(Walk):
    """Walk whose state is nested."""

    def initial(self, noise):
        x = np.zeros(len(noise))
        return Nested(Inner(x), (x, np.zeros((len(noise), 2))))

    def step(self, state, noise):
        return Nested(Inner(self.move(state.inner.x, noise)), state.pair)

    def signals(self, state):
        return {"x": state.inner.x}


class Point(NamedTuple):
    """State that is a named tuple."""

    x: Floats


class TupleWalk(Walk):
    """Walk whose state is a named tuple."""

    def initial(self, noise):
        return Point(np.zeros(len(noise)))

    def step(self, state, noise):
        return Point(self.move(state.x, noise))

    def signals(self, state):
        return {"x": state.x}


class ArrayWalk(Walk):
    """Walk whose state is one array."""

    def initial(self, noise):
        return np.zeros(len(noise))

    def step(self, state, noise):
        return self.move(state, noise)

    def signals(self, state):
        return {"x": state}


class Odometer(Walk):
    """Walk whose state counts its own steps, as a planner counts its solves."""

    def initial(self, noise):
        return {"x": np.zeros(len(noise)), "n": np.zeros(len(noise), dtype=np.int64)}

    def step(self, state, noise):
        return {"x": self.move(state["x"], noise), "n": state["n"] + 1}

    def counts(self, state):
        return {"steps": state["n"]}


class Doomed(Walk):
    """Walk with an error at the step after x exceeds ``brink``: errors correlate with risk."""

    def __init__(self, brink):
        super().__init__()
        self.brink = brink

    def step(self, state, noise):
        return {"x": np.where(state["x"] > self.brink, np.nan, self.move(state["x"], noise))}


class Broken(Walk):
    """Walk that raises in every step."""

    def step(self, state, noise):
        raise ZeroDivisionError("no row survives this")


class Deadly(Walk):
    """Walk that ends its worker process silently; harmless in the main process."""

    def step(self, state, noise):
        if multiprocessing.parent_process() is not None:
            os._exit(3)
        return super().step(state, noise)


class Native(Fragile):
    """Walk that ends its process where a second noise channel exceeds ``beyond``, or hangs, in a worker.

    In the main process such a rollout raises, so that all others can be compared.
    """

    def __init__(self, how, beyond):
        super().__init__("raise", beyond)
        self.end = how

    def _state(self, x, noise, now):
        if now and (noise[:, 1] > self.beyond).any() and multiprocessing.parent_process() is not None:
            {"abort": os.abort, "fault": _read_null, "exit": lambda: os._exit(5), "hang": _hang}[self.end]()
        return super()._state(x, noise, now)


def _read_null():
    ctypes.string_at(0)


def _hang():
    while True:
        time.sleep(1.0)


class Leak(Walk):
    """Walk of a library that keeps memory at each step, in a worker: 4 MiB a call, of 256 MiB at most."""

    kept: ClassVar[list[bytearray]] = []

    def step(self, state, noise):
        if multiprocessing.parent_process() is not None:
            base = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            if not self.kept:
                resource.setrlimit(resource.RLIMIT_AS, (base + 2**28, base + 2**28))
            self.kept.append(bytearray(2**22))
        return super().step(state, noise)


class Homesick(Walk):
    """Walk that pickles, but cannot be unpickled in another process."""

    def __init__(self):
        super().__init__()
        self.home = os.getpid()

    def __setstate__(self, state):
        if state["home"] != os.getpid():
            raise RuntimeError("this system lives in one process only")
        self.__dict__ = state


class Infinite(Still):
    """System whose x is infinite where the noise is positive, y where it exceeds 1: x - y may be NaN."""

    def initial(self, noise):
        return {name: np.where(noise[:, 0] > limit, np.inf, 0.0) for name, limit in (("x", 0.0), ("y", 1.0))}


def height(signals, t):
    """Return the score: the current x."""
    return np.asarray(signals["x"][:, t])


def backwards(signals, t):
    """Score that prefers the rows that will not fail."""
    return -height(signals, t)


class OnceInAWorker(Walk):
    """Walk on which one worker process has an accident: ``marker`` is a file that says it was this one."""

    def __init__(self, accident, marker):
        super().__init__()
        self.accident, self.marker = accident, marker

    def step(self, state, noise):
        if multiprocessing.parent_process() is not None:
            try:
                os.close(os.open(self.marker, os.O_CREAT | os.O_EXCL))
            except FileExistsError:  # another worker has had the accident
                pass
            else:
                getattr(self, self.accident)()
        return super().step(state, noise)

    def stop(self):
        """Stop, as a debugger or a job scheduler would stop it."""
        os.kill(os.getpid(), signal.SIGSTOP)

    def run_out_of_memory(self):
        """Fail to get memory where no rollout is to blame."""
        engine.Rollouts = _no_memory

    def die_in_its_answer(self):
        """Be killed when half of the answer is in the pipe."""

        def send(connection, content, write=None):
            if len(content) > 1000:
                os.write(connection.fileno(), bytes(content)[: len(content) // 2])
                os.kill(os.getpid(), signal.SIGKILL)
            while content:
                content = content[os.write(connection.fileno(), content) :]

        Connection._send = send

    def leave_a_child(self):
        """Be killed while a child of its own still has the pipe."""
        if os.fork() == 0:
            time.sleep(20.0)
            os._exit(0)
        os.kill(os.getpid(), signal.SIGKILL)


def _no_memory(*arguments):
    raise MemoryError


def rows_of_checks(system, steps, branch=False):
    """Return rows that the checks of an estimate step: the probe before it, and the replay after it."""
    counting = Counting(system)
    probe(counting, min(STEPS, steps), branch=branch)
    return counting.rows + steps
