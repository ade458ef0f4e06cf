"""FMUs as simulators and controllers."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return descriptions of the simulator and the controller."""
    return [
        Component(
            kind="simulator",
            name="fmi",
            config="avrare_fmi.config:SimulatorConfig",
            factory="avrare_fmi.parts:build_simulator",
            summary="an FMU for co-simulation",
            needs=("fmpy",),
        ),
        Component(
            kind="controller",
            name="fmi",
            config="avrare_fmi.config:FmuConfig",
            factory="avrare_fmi.parts:build_controller",
            summary="an FMU for co-simulation",
            needs=("fmpy",),
        ),
    ]
