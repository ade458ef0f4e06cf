"""Glider that lands on a wire post-stall, as a simulator of scenarios."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the simulator of this distribution."""
    return [
        Component(
            kind="simulator",
            name="glider",
            config="avrare_glider.config:GliderConfig",
            factory="avrare_glider.simulator:build",
            summary="perching glider under time-varying linear-quadratic feedback",
        ),
    ]
