"""highway-env as a simulator driven by the noise tape."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return descriptions of the simulator and the controller."""
    return [
        Component(
            kind="simulator",
            name="highway_env",
            config="avrare_highway_env.config:HighwayEnvConfig",
            factory="avrare_highway_env.simulator:build",
            summary="highway-env's merge, highway, intersection and roundabout, with lidar and moody drivers",
            needs=("highway_env",),
        ),
        Component(
            kind="controller",
            name="path_follower",
            config="avrare_highway_env.config:PathFollowerConfig",
            factory="avrare_highway_env.path_follower:build",
            summary="pure pursuit along waypoints in highway_env, with car following",
        ),
    ]
