"""An executor on Ray: the chunks of an estimate on the machines of a cluster."""

from __future__ import annotations

from avrare.plugin.component import Component
from avrare.plugin.hookspecs import hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """The executor of this plugin."""
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
