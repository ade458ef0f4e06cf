"""Executor that runs everything in this process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from pydantic import BaseModel, ConfigDict, Field

from avrare.rollout.executors.work import Work
from avrare.rollout.request import Request, Rollouts


class ExecutorConfig(BaseModel):
    """Options of the core's executors."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    workers: int = Field(default=1, ge=1, le=1024, description="processes")


def build(config: ExecutorConfig, scene: object | None = None) -> SerialExecutor:
    """Build the executor."""
    return SerialExecutor()


class SerialExecutor:
    """Executor that runs one chunk after another."""

    def open(self, work: Work) -> None:
        """Remember the work."""
        self._work = work

    def map(self, chunks: Iterable[Request]) -> Iterator[Rollouts]:
        """Yield outcomes in the order of the chunks."""
        return (self._work.run(chunk) for chunk in chunks)

    def close(self) -> None:
        """Do nothing: there are no workers."""
