"""Chunks in flight on workers that may die: outcomes in order, lost chunks run again.

A chunk has its own random streams, so running it again gives the same bits.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, Protocol

from avrare.base.errors import AvrareError, ExitCode
from avrare.rollout.executors.work import Task

MOST_LOSSES = 3
"""Number of worker deaths after which a chunk is given up; from the second on it runs by itself."""


class WorkerLost(Exception):
    """A worker ended while it ran a chunk; the argument says how, where that is known."""


class WorkerDied(AvrareError):
    """Workers died repeatedly on the same chunk."""

    exit_code = ExitCode.ROLLOUT_ERRORS


class Ticket(Protocol):
    """Handle of a chunk that a worker runs."""

    def done(self) -> bool:
        """Return True once there is an outcome, or can be none."""

    def result(self) -> Any:
        """Wait for the outcome and return it; raise ``WorkerLost`` if the worker died."""


class Crew(Protocol):
    """Group of workers that run chunks.

    Attributes:
        restarts: Number of times that workers were replaced.
    """

    restarts: int

    def submit(self, chunk: Task) -> Ticket:
        """Give a chunk to a worker; raise ``WorkerLost`` if none is left."""

    def replace_lost(self) -> None:
        """Start workers in place of those that died."""


@dataclass
class _Flight:
    chunk: Task
    ticket: Ticket | None = None
    losses: int = 0


class Window:
    """Ordered map over chunks with at most ``size`` of them in flight."""

    def __init__(self, crew: Crew, size: int) -> None:
        self.crew, self.size = crew, size
        self._flights: deque[_Flight] = deque()

    @property
    def busy(self) -> bool:
        """True while a worker runs a chunk."""
        return any(flight.ticket is not None and not flight.ticket.done() for flight in self._flights)

    def map(self, chunks: Iterable[Task]) -> Iterator[Any]:
        """Yield outcomes in the order of the chunks, taking a chunk when there is room for it."""
        source, flights = iter(chunks), self._flights
        while True:
            flights.extend(_Flight(chunk) for chunk in islice(source, max(self.size - len(flights), 0)))
            if not flights:
                return
            try:
                self._submit()
                head = flights[0].ticket
                assert head is not None
                outcome = head.result()
            except WorkerLost as loss:
                self._recover(str(loss) or "killed, out of memory, or failed to start")
                continue
            flights.popleft()
            yield outcome

    def _submit(self) -> None:
        # A chunk suspected of killing workers runs by itself, so that the culprit is certain.
        suspected = any(flight.losses > 1 for flight in self._flights)
        for flight in islice(self._flights, 1 if suspected else None):
            if flight.ticket is None:
                flight.ticket = self.crew.submit(flight.chunk)

    def _recover(self, end: str) -> None:
        self.crew.restarts += 1
        self.crew.replace_lost()  # first: it also waits until every lost chunk is known
        lost = [flight for flight in self._flights if flight.ticket is not None and _is_lost(flight.ticket)]
        for flight in lost or [self._flights[0]]:
            flight.ticket = None
            flight.losses += 1
        worst = max(self._flights, key=lambda flight: flight.losses)
        if worst.losses >= MOST_LOSSES:
            raise WorkerDied(
                f"a worker process ended without an answer ({end}), {worst.losses} times "
                f"{worst.chunk.describe()}",
                "run with a single worker to see the cause",
            ) from None


def _is_lost(ticket: Ticket) -> bool:
    with contextlib.suppress(Exception):  # another exception is raised when its turn comes
        try:
            if ticket.done():
                ticket.result()
        except WorkerLost:
            return True
    return False
