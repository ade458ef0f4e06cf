"""Everything in this process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from avrare.execute.config import ExecutorConfig
from avrare.execute.work import Work
from avrare.rollout.request import Request, Rollouts


def build(config: ExecutorConfig, scene: object | None = None) -> SerialExecutor:
    """The executor of a scenario or a call."""
    return SerialExecutor()


class SerialExecutor:
    """Runs one chunk after another."""

    def open(self, work: Work) -> None:
        """Remember the work."""
        self._work = work

    def map(self, chunks: Iterable[Request]) -> Iterator[Rollouts]:
        """Outcomes in the order of the chunks."""
        return (self._work.run(chunk) for chunk in chunks)

    def close(self) -> None:
        """Nothing to stop."""
