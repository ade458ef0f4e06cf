"""Kinematic single-track driving simulator on a straight multi-lane road."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the simulators ``single_track`` and ``commonroad``."""
    return [
        Component(
            kind="simulator",
            name="single_track",
            config="avrare_single_track.config:SingleTrackConfig",
            factory="avrare_single_track.simulator:build",
            summary="road with or without bends, kinematic single-track ego, scripted vehicles",
            needs=("casadi",),
        ),
        Component(
            kind="simulator",
            name="commonroad",
            config="avrare_single_track.file_config:RecordedConfig",
            factory="avrare_single_track.recorded:build",
            summary="recorded scene of CommonRoad, highD or inD; the others are replayed or react",
            needs=("casadi", "commonroad"),
        ),
    ]
