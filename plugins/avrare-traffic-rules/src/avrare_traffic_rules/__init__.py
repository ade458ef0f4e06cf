"""Traffic rules of interstates and intersections, RSS and time to collision in temporal logic."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the specification ``traffic_rules``."""
    return [
        Component(
            kind="specification",
            name="traffic_rules",
            config="avrare_traffic_rules.config:TrafficRuleConfig",
            factory="avrare_traffic_rules.rule:build",
            summary="R_G1-R_G4, R_I1-R_I5, R_IN1-R_IN5, RSS, time to collision, or your own formula",
            rules="avrare_traffic_rules.catalogue:rules",
            check="avrare_traffic_rules.check:check",
        )
    ]
