"""Interstate traffic rules R_G1, R_G2, R_G4, R_I2 and no-collision as temporal logic."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """The specifications of this distribution."""
    return [
        Component(
            kind="specification",
            name="traffic_rules",
            config="avrare_traffic_rules.config:TrafficRuleConfig",
            factory="avrare_traffic_rules.rule:build",
            summary="R_G1, R_G2, R_G4, R_I2 and no_collision as temporal logic",
        )
    ]
