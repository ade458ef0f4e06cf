"""Pace of an estimate with a budget of seconds: how many rows the time left pays for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Pace:
    """Rows per second since the first outcome, which also took what begins once: workers, imports, caches."""

    began: float | None = None  # time of the first outcome [s]
    rows: int = 0  # finished since then
    flight: int = 0  # given out and not finished

    def take(self, now: float, left: float, most: int) -> int:
        """Return how many of ``most`` rows to run next in the seconds ``left``; 0: none."""
        rows = 1 if left > 0.0 else 0  # one, until two outcomes say how long that takes
        if self.began is not None and self.rows:
            rate = self.rows / max(now - self.began, 1e-9)
            rows = min(most, max(int(rate * left) - self.flight, 0))
        self.flight += rows
        return rows

    def finish(self, now: float, rows: int) -> None:
        """Count the rows of an outcome."""
        self.flight -= rows
        if self.began is None:
            self.began = now
        else:
            self.rows += rows
