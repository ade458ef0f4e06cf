"""Example plugin: a water tank and a specification of the spilled volume."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return descriptions of the simulator and the specification."""
    return [
        Component(
            kind="simulator",
            name="tank",
            config="avrare_example.config:TankConfig",
            factory="avrare_example.tank:build",
            summary="water tank with an outlet valve and a randomly varying inflow",
        ),
        Component(
            kind="specification",
            name="spillage",
            config="avrare_example.config:SpillageConfig",
            factory="avrare_example.spillage:build",
            summary="total volume that flows over the rim stays below a limit",
        ),
    ]
