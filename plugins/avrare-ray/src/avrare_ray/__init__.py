"""Ray executor: chunks of an estimate on the machines of a cluster."""

from __future__ import annotations

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the description of the executor."""
    return [
        Component(
            kind="executor",
            name="ray",
            config="avrare_ray.config:RayConfig",
            factory="avrare_ray.executor:build",
            summary="chunks on the workers of a Ray cluster",
            needs=("ray",),
        )
    ]
