"""Lane-change model-predictive controller and trajectory planner."""

import importlib.util

from avrare.plugin.component import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the controller ``mpc``."""
    not_compiled = "; riccati backend not compiled, pip install 'avrare-mpc[fast]'"
    note = not_compiled if importlib.util.find_spec("numba") is None else ""
    return [
        Component(
            kind="controller",
            name="mpc",
            config="avrare_mpc.config:MpcConfig",
            factory="avrare_mpc.controller:build",
            summary=f"lane-change model-predictive controller, solved by CasADi or a Riccati recursion{note}",
            needs=("casadi",),
            driving=True,
        )
    ]
