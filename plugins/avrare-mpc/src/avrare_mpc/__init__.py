"""Lane-change model-predictive controller and trajectory planner."""

import importlib.util

from avrare.plugin.component import Component
from avrare.plugin.hookspecs import hookimpl

SLOW = "; riccati backend not compiled, pip install 'avrare-mpc[fast]'"


@hookimpl
def avrare_components() -> list[Component]:
    """The controller ``mpc``."""
    slow = SLOW if importlib.util.find_spec("numba") is None else ""
    return [
        Component(
            kind="controller",
            name="mpc",
            config="avrare_mpc.config:MpcConfig",
            factory="avrare_mpc.controller:build",
            summary=f"lane-change model-predictive controller, solved by CasADi or a Riccati recursion{slow}",
            needs=("casadi",),
            driving=True,
        )
    ]
