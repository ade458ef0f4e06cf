"""Lane-change model-predictive controller and trajectory planner in CasADi."""

from avrare.plugin.component import Component
from avrare.plugin.hookspecs import hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """The controller ``mpc``."""
    return [
        Component(
            kind="controller",
            name="mpc",
            config="avrare_mpc.config:MpcConfig",
            factory="avrare_mpc.controller:build",
            summary="lane-change model-predictive controller, solved by fatrop or ipopt",
            needs=("casadi",),
        )
    ]
