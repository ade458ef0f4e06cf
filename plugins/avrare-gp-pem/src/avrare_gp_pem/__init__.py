"""Perception error models: fitted to a detector (Gaussian processes, networks), and a parametric one."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the perception error models of this plugin."""
    return [
        Component(
            kind="perception",
            name="gp_pem",
            config="avrare_gp_pem.config:GpPemConfig",
            factory="avrare_gp_pem.runtime.models:build_gp",
            summary="fitted to a lidar detector, or to your own (shipped models: non-commercial licence)",
            driving=True,
        ),
        Component(
            kind="perception",
            name="parametric",
            config="avrare_gp_pem.config:ParametricPemConfig",
            factory="avrare_gp_pem.runtime.models:build_parametric",
            summary="detection falling with range, Student-t position errors; free of licensed data",
            driving=True,
        ),
        Component(
            kind="perception",
            name="naive",
            config="avrare_gp_pem.config:NaivePemConfig",
            factory="avrare_gp_pem.runtime.models:build_naive",
            summary="misses half and adds unit noise: a proposal for importance sampling, no detector",
            driving=True,
        ),
    ]
