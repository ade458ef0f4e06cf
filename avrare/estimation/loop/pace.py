"""Pace of an estimate with a budget of seconds: how many rows the time left pays for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Pace:
    """Rows per second since the first was given out.

    The start of workers counts: several outcomes that arrive at once say nothing of how long one takes.
    """

    began: float | None = None  # time at which the first row was given out [s]
    rows: int = 0  # finished
    flight: int = 0  # given out and not finished

    def take(self, now: float, left: float, most: int, first: bool = False) -> int:
        """Return how many of ``most`` rows to run next in the seconds ``left``; 0: none.

        The ``first`` row of an estimate runs however little time is left, or there would be no result.
        """
        if self.began is None:
            self.began = now
        rows = 1 if first or left > 0.0 else 0  # one at a time, until an outcome says how long that takes
        if self.rows:
            rate = self.rows / max(now - self.began, 1e-9)
            rows = max(min(most, int(rate * left) - self.flight), 0)
        self.flight += rows
        return rows

    def finish(self, rows: int) -> None:
        """Count the rows of an outcome."""
        self.flight -= rows
        self.rows += rows
