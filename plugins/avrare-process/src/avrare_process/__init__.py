"""Programs in any language as simulators and controllers."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return descriptions of the simulator and the controller."""
    return [
        Component(
            kind="simulator",
            name="process",
            config="avrare_process.config:ProcessConfig",
            factory="avrare_process.parts:build_simulator",
            summary="a program in any language, behind a few messages",
        ),
        Component(
            kind="controller",
            name="process",
            config="avrare_process.config:ProcessConfig",
            factory="avrare_process.parts:build_controller",
            summary="a program in any language, behind a few messages",
        ),
    ]
