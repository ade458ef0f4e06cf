"""Vehicles between the frame of the road and the plane; on a straight road both are the same."""

from __future__ import annotations

import dataclasses

import numpy as np

from avrare.driving.reference_line import ReferenceLine
from avrare.driving.values import Road, Vehicles, World


def to_plane(road: Road, vehicles: Vehicles) -> Vehicles:
    """Return vehicles of the road's frame in the plane."""
    if road.line is None:
        return vehicles
    x, y, heading, _ = road.line.frame(vehicles.x)
    return dataclasses.replace(
        vehicles,
        x=x - vehicles.y * np.sin(heading),
        y=y + vehicles.y * np.cos(heading),
        heading=vehicles.heading + heading,
    )


def to_road(line: ReferenceLine, vehicles: Vehicles) -> Vehicles:
    """Return vehicles of the plane in the frame of a line; NaN where they have no foot on it."""
    s, d = line.to_road(vehicles.x, vehicles.y)
    return dataclasses.replace(vehicles, x=s, y=d, heading=vehicles.heading - line.heading(s))


def world_in_plane(road: Road, world: World) -> World:
    """Return a world of the road's frame in the plane."""
    if road.line is None:
        return world
    return dataclasses.replace(world, ego=to_plane(road, world.ego), others=to_plane(road, world.others))
