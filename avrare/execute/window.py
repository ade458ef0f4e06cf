"""Chunks on workers that may die: a bounded number in flight, outcomes in order, lost chunks run again.

A chunk has its own random streams, so running it again gives the same bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Protocol

from avrare.errors import AvrareError, ExitCode
from avrare.rollout.request import Request, Rollouts

MOST_LOSSES = 3
"""Times that a chunk may take its worker with it; from the second on it runs alone, so that it is known."""


class WorkerLost(Exception):
    """A worker ended with a chunk in its hands."""


class WorkerDied(AvrareError):
    """A worker ends without an answer, again and again."""

    exit_code = ExitCode.ROLLOUT_ERRORS


class Ticket(Protocol):
    """A chunk in the hands of a worker."""

    def done(self) -> bool:
        """Whether there is an answer, or will never be one."""

    def result(self) -> Rollouts:
        """The outcome, waiting for it.

        Raises:
            WorkerLost: The worker is gone.
        """


class Crew(Protocol):
    """Workers that take chunks."""

    def submit(self, chunk: Request) -> Ticket:
        """Hand a chunk to a worker.

        Raises:
            WorkerLost: There is none left.
        """

    def replace_lost(self) -> None:
        """Start workers in the place of those that are gone."""


@dataclass
class _Flight:
    chunk: Request
    ticket: Ticket | None = None
    losses: int = 0

    @property
    def waiting(self) -> bool:
        return self.ticket is not None and not self.ticket.done()


class Window:
    """An ordered map over chunks with at most ``size`` of them in flight.

    Args:
        crew: Who works.
        size: Chunks in flight.
    """

    def __init__(self, crew: Crew, size: int) -> None:
        self.crew, self.size = crew, size
        self.restarts = 0
        self._flights: deque[_Flight] = deque()

    @property
    def busy(self) -> bool:
        """Whether a chunk is in the hands of a worker."""
        return any(flight.waiting for flight in self._flights)

    def map(self, chunks: Iterable[Request]) -> Iterator[Rollouts]:
        """Outcomes in the order of the chunks, which are taken one by one as there is room.

        Raises:
            WorkerDied: A chunk has lost its worker too often.
        """
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
            except WorkerLost:
                self._recover()
                continue
            flights.popleft()
            yield outcome

    def _submit(self) -> None:
        doubtful = any(flight.losses > 1 for flight in self._flights)
        for flight in islice(self._flights, 1 if doubtful else None):
            if flight.ticket is None:
                flight.ticket = self.crew.submit(flight.chunk)

    def _recover(self) -> None:
        self.restarts += 1
        self.crew.replace_lost()  # first: it also waits until every lost chunk is known
        lost = [flight for flight in self._flights if flight.ticket is not None and _is_lost(flight.ticket)]
        for flight in lost or [self._flights[0]]:
            flight.ticket = None
            flight.losses += 1
        worst = max(self._flights, key=lambda flight: flight.losses)
        if worst.losses >= MOST_LOSSES:
            raise WorkerDied(
                "a worker process ended without an answer (killed, out of memory, or failed to start), "
                f"{worst.losses} times on {_label(worst.chunk)}",
                "run with --workers 1 to see what happens; in a script, guard the call with "
                '`if __name__ == "__main__":`',
            )


def _is_lost(ticket: Ticket) -> bool:
    """Whether the worker went with the chunk; what is still in good hands stays there."""
    if not ticket.done():
        return False
    try:
        ticket.result()
    except WorkerLost:
        return True
    except Exception:  # it is told when its turn comes
        return False
    return False


def _label(chunk: Request) -> str:
    """A chunk by the address of its first rollout."""
    first = f"run {chunk.run[0]}, stage {chunk.stage[0]}, particle {chunk.particle[0]}"
    return f"the chunk of {chunk.rows} rollouts that begins at {first}"
