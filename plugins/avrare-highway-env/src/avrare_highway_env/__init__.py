"""highway-env as a simulator whose randomness is its noise."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """The simulator and the controller of this distribution."""
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
            config="avrare_highway_env.path_follower_config:PathFollowerConfig",
            factory="avrare_highway_env.path_follower:build",
            summary="pure pursuit along waypoints in highway_env, minding what is on the path",
        ),
    ]
