"""The executor: one actor a worker, which holds the problem; a dead actor is replaced.

Requests and outcomes travel as bytes: Ray would hand out arrays that must not be written to.
"""

from __future__ import annotations

import contextlib
import importlib
import pickle
import signal
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from avrare.errors import AvrareError
from avrare.execute.processes import pickled
from avrare.execute.window import Window, WorkerLost
from avrare.execute.work import Work
from avrare.rollout.request import Request, Rollouts
from avrare_ray.config import RayConfig

_IN_FLIGHT = 2
"""Chunks in flight for each worker: one in hand, one at the door."""
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def build(config: RayConfig, scene: object | None = None) -> RayExecutor:
    """The executor of a scenario or a call."""
    return RayExecutor(config)


class Worker:
    """What an actor does.

    Args:
        payload: The pickled work.
    """

    def __init__(self, payload: bytes) -> None:
        self.work: Work = pickle.loads(payload)

    def run(self, chunk: bytes) -> bytes:
        """The outcome of a chunk, or an error that the user can do something about, pickled."""
        try:
            return pickle.dumps(self.work.run(pickle.loads(chunk)))
        except AvrareError as error:
            return pickle.dumps(error)


class RayExecutor:
    """Runs chunks on Ray actors, with the same bits as anywhere else."""

    def __init__(self, config: RayConfig) -> None:
        self.config = config
        self._window = Window(self, _IN_FLIGHT * config.workers)
        self._hands: list[_Hand] = []
        self._ray: Any = None
        self._mine = False
        self._payload: Any = None

    @property
    def restarts(self) -> int:
        """How often workers had to be replaced."""
        return self._window.restarts

    def open(self, work: Work) -> None:
        """Join the cluster, or start one on this machine, and place the actors.

        Raises:
            UsageError: The problem cannot be sent to another process.
            AvrareError: There is no such cluster.
        """
        payload = pickled(work)
        self._ray = importlib.import_module("ray")
        if not self._ray.is_initialized():
            self._join()
        self._payload = self._ray.put(payload)
        self._hands = [self._hire() for _ in range(self.config.workers)]

    def map(self, chunks: Iterable[Request]) -> Iterator[Rollouts]:
        """Outcomes in the order of the chunks.

        Raises:
            WorkerDied: Workers die of the same chunk again and again.
        """
        return self._window.map(chunks)

    def submit(self, chunk: Request) -> _Ticket:
        """Hand a chunk to the worker with the least to do."""
        hand = min(self._hands, key=lambda one: one.load)
        ticket = _Ticket(self._ray, hand, hand.actor.run.remote(pickle.dumps(chunk)))
        hand.tickets.append(ticket)
        return ticket

    def replace_lost(self) -> None:
        """A new actor for each that has died."""
        self._hands = [self._hire() if hand.dead else hand for hand in self._hands]

    def close(self) -> None:
        """Send the actors home, and stop the cluster if it is ours."""
        if self._ray is None:
            return
        for hand in self._hands:
            with contextlib.suppress(Exception):  # it may be dead already
                self._ray.kill(hand.actor)
        if self._mine:
            self._ray.shutdown()
        self._hands, self._ray, self._payload, self._mine = [], None, None, False

    def _join(self) -> None:
        options: dict[str, Any] = {"address": self.config.address} if self.config.address else {}
        if self.config.runtime_env:
            options["runtime_env"] = self.config.runtime_env
        try:
            with _own_sigterm():
                self._ray.init(log_to_driver=False, logging_level="warning", **options)
        except Exception as error:  # of many kinds: no such host, another version, no right to
            where = self.config.address or "on this machine"
            text = " ".join(str(error).split())
            raise AvrareError(f"no Ray cluster {where}: {text}", "see `ray status`") from error
        self._mine = True

    def _hire(self) -> _Hand:
        environment = {**_ONE_THREAD, **self.config.runtime_env.get("env_vars", {})}
        remote = self._ray.remote(
            num_cpus=self.config.cpus_per_worker,
            max_restarts=0,
            runtime_env={**self.config.runtime_env, "env_vars": environment},
        )
        return _Hand(remote(Worker).remote(self._payload), [])


@contextlib.contextmanager
def _own_sigterm() -> Iterator[None]:
    """Ray puts a handler of its own for SIGTERM; what the signal means here is not its to say."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


@dataclass
class _Hand:
    actor: Any
    tickets: list[_Ticket]
    dead: bool = False

    @property
    def load(self) -> int:
        """Chunks that it has not done yet."""
        self.tickets = [ticket for ticket in self.tickets if not ticket.done()]
        return len(self.tickets)


@dataclass(frozen=True)
class _Ticket:
    ray: Any
    hand: _Hand
    reference: Any

    def done(self) -> bool:
        return self.hand.dead or bool(self.ray.wait([self.reference], timeout=0)[0])

    def result(self) -> Rollouts:
        lost = self.ray.exceptions
        try:
            answer = pickle.loads(self.ray.get(self.reference))
        except (
            lost.RayActorError,
            lost.ObjectLostError,
            lost.WorkerCrashedError,
            lost.NodeDiedError,
        ) as error:
            self.hand.dead = True
            raise WorkerLost from error
        if isinstance(answer, AvrareError):
            raise answer
        assert isinstance(answer, Rollouts)
        return answer
