"""Kinematic single-track driving simulator on a straight multi-lane road."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the simulator ``single_track``."""
    return [
        Component(
            kind="simulator",
            name="single_track",
            config="avrare_single_track.config:SingleTrackConfig",
            factory="avrare_single_track.simulator:build",
            summary="straight road, kinematic single-track ego, scripted vehicles",
            needs=("casadi",),
        )
    ]
