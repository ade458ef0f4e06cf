"""The example plugin: a water tank, and how much of it is spilled."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """The simulator and the specification of this distribution."""
    return [
        Component(
            kind="simulator",
            name="tank",
            config="avrare_example.config:TankConfig",
            factory="avrare_example.tank:build",
            summary="water tank with a valve and an inflow that comes in surges",
        ),
        Component(
            kind="specification",
            name="spillage",
            config="avrare_example.config:SpillageConfig",
            factory="avrare_example.spillage:build",
            summary="what flows over the rim in all stays below a limit",
        ),
    ]
