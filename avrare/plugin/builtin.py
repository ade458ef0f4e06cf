"""The core's own components, registered through the same hook as everyone else's."""

from __future__ import annotations

from avrare.plugin.component import Component
from avrare.plugin.hookspecs import hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Plain Monte Carlo and the executors that need nothing but Python."""
    return [
        Component(
            kind="estimator",
            name="mc",
            config="avrare.estimation.config:McConfig",
            factory="avrare.estimation.montecarlo:build",
            summary="plain Monte Carlo, with Clopper-Pearson intervals",
        ),
        Component(
            kind="executor",
            name="serial",
            config="avrare.execute.config:ExecutorConfig",
            factory="avrare.execute.serial:build",
            summary="one chunk after another in this process",
        ),
        Component(
            kind="executor",
            name="processes",
            config="avrare.execute.config:ExecutorConfig",
            factory="avrare.execute.processes:build",
            summary="chunks on worker processes of this machine",
        ),
    ]
