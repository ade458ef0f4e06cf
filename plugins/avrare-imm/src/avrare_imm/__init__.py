"""Interacting-multiple-model tracker for highway traffic, batched over particles and vehicles."""

from __future__ import annotations

from avrare.plugin.component import Component
from avrare.plugin.hookspecs import hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """The tracker of this plugin."""
    return [
        Component(
            kind="tracker",
            name="imm",
            config="avrare_imm.config:ImmConfig",
            factory="avrare_imm.tracker:build",
            summary="Interacting multiple models: speed along the road, lane across it",
        )
    ]
