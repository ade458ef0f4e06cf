"""Interacting-multiple-model tracker for highway traffic, batched over particles and vehicles."""

from __future__ import annotations

from avrare.plugin.component import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the trackers ``imm`` and ``filterpy``."""
    return [
        Component(
            kind="tracker",
            name="imm",
            config="avrare_imm.config:ImmConfig",
            factory="avrare_imm.tracker:build",
            summary="Interacting multiple models: speed along the road, lane across it",
        ),
        Component(
            kind="tracker",
            name="filterpy",
            config="avrare_imm.config:ImmConfig",
            factory="avrare_imm.filterpy_tracker:build",
            summary="the same models run by filterpy, one track at a time: slow, to compare with",
            needs=("filterpy",),
        ),
    ]
