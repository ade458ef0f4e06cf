"""Components of the core, registered through the same hook as those of plugins."""

from __future__ import annotations

from avrare.plugin.component import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return plain Monte Carlo and the executors that need no further package."""
    return [
        Component(
            kind="estimator",
            name="mc",
            config="avrare.estimation.config:McConfig",
            factory="avrare.estimation.monte_carlo:build",
            summary="plain Monte Carlo, with Clopper-Pearson intervals",
        ),
        Component(
            kind="executor",
            name="serial",
            config="avrare.rollout.executors.serial:ExecutorConfig",
            factory="avrare.rollout.executors.serial:build",
            summary="one chunk after another in this process",
        ),
        Component(
            kind="executor",
            name="processes",
            config="avrare.rollout.executors.serial:ExecutorConfig",
            factory="avrare.rollout.executors.processes:build",
            summary="chunks on worker processes of this machine",
        ),
    ]
