"""Where on the road the ego may be."""

from __future__ import annotations

from avrare.driving import Scene
from avrare.errors import UsageError
from avrare_mpc.config import MpcConfig


def lane_centres(config: MpcConfig, scene: Scene) -> tuple[float, ...]:
    """Lateral positions of the lanes that the ego may use [m].

    Raises:
        UsageError: The road has no such lane.
    """
    known = scene.road.lane_centres
    if max(config.lanes) >= len(known):
        raise UsageError(f"lanes: there is no lane {max(config.lanes)}, the road has {len(known)} lanes")
    return tuple(known[lane] for lane in config.lanes)


def lateral_bounds(config: MpcConfig, scene: Scene) -> tuple[float, float]:
    """Where the ego's centre may be so that its side keeps the margin from the edge of its lanes [m]."""
    centres = lane_centres(config, scene)
    room = (scene.road.lane_width - scene.ego_width) / 2 - config.y_margin
    return min(centres) - room, max(centres) + room
