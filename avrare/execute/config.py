"""Options of the core's executors."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class ExecutorConfig(BaseModel):
    """Where the chunks of work run."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    workers: int = Field(default=1, ge=1, le=1024, description="processes")
