"""Options of the Ray executor."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from avrare.plugin import Options


class RayConfig(Options):
    """Options of the executor ``ray``: the cluster and the resources of a worker."""

    workers: int = Field(
        default=1, ge=1, le=10_000, description="number of actors, each with the problem in memory"
    )
    address: str | None = Field(
        default=None,
        description="address of the cluster: auto, HOST:PORT or ray://HOST:PORT; default: RAY_ADDRESS, else "
        "a cluster on this machine for the duration of the run",
    )
    cpus_per_worker: float = Field(default=1.0, gt=0.0, description="CPUs that Ray reserves per worker")
    runtime_env: dict[str, Any] = Field(
        default={}, description="Ray runtime environment of the workers: working_dir, pip, env_vars, ..."
    )
