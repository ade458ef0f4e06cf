"""OpenSCENARIO XML as scenarios: what is read, and the traffic that acts it out."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the simulator ``openscenario``."""
    return [
        Component(
            kind="simulator",
            name="openscenario",
            config="avrare_openscenario.config:OpenScenarioConfig",
            factory="avrare_openscenario.simulator:build",
            complete="avrare_openscenario.completion:complete",
            scenes="avrare_openscenario.distributions:list_scenes",
            summary="OpenSCENARIO XML scene: a single-track ego among vehicles that act out its storyboard",
        )
    ]
