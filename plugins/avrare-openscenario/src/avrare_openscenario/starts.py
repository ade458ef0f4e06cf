"""Starts of vehicles: positions of a file, converted to the frame of the road."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Vehicles
from avrare.protocols import Floats
from avrare_openscenario.courses import Integers
from avrare_openscenario.network import RoadMap
from avrare_openscenario.story import Place, Storyboard, TargetSpeed, Trajectory
from avrare_openscenario.trajectories import Path, Pose, list_places


def nearest_lane(roads: RoadMap, y: Floats, s: Floats) -> Integers:
    """Return the index of the lane whose centre is nearest to offsets at stations of the same shape."""
    centres = roads.middles(np.asarray(s))
    if not centres.shape[-1]:
        return np.full(np.shape(y), -1)
    apart = np.abs(np.asarray(y)[..., None] - centres)
    return np.asarray(np.where(np.isnan(apart), np.inf, apart).argmin(axis=-1))


def lane_middle(roads: RoadMap, lane: Integers, s: Floats) -> Floats:
    """Return y of the centre of lanes at stations [m], NaN where there is no such lane."""
    centres = roads.middles(np.asarray(s))
    inside = (lane >= 0) & (lane < centres.shape[-1])
    chosen = np.take_along_axis(centres, np.where(inside, lane, 0)[..., None], axis=-1)[..., 0]
    return np.where(inside, chosen, np.nan)


def lane_direction(roads: RoadMap, y: Floats, s: Floats) -> Floats:
    """Return 1 where traffic goes along the road, -1 where it comes towards it."""
    opposing = np.isin(nearest_lane(roads, y, s), roads.road.opposing)
    return np.where(opposing, -1.0, 1.0)


def place_all(story: Storyboard, maps: Sequence[RoadMap], table: Floats) -> Pose:
    """Return stations, offsets and headings (N, V + 1) of all points of reference at the start.

    Raises:
        UsageError: Places are relative to each other in a circle.
    """
    needs = [list_places(place) for place in story.places]
    poses: dict[int, Pose] = {}
    for k in _order(needs):
        poses[k] = place_point(story.places[k], maps[k], maps, table, poses)
    s, d, heading = (np.stack([poses[k][axis] for k in range(len(poses))], axis=1) for axis in range(3))
    return s, d, heading


def speed_all(story: Storyboard, table: Floats) -> Floats:
    """Return the speeds (N, V + 1) of all vehicles at the start."""
    speeds = np.zeros((len(table), len(story.speeds)))
    for k in _order([[speed.other] if speed.other >= 0 else [] for speed in story.speeds]):
        speeds[:, k] = resolve_speed(story.speeds[k], table, speeds)
    return speeds


def resolve_speed(target: TargetSpeed, table: Floats, speeds: Floats) -> Floats:
    """Return a speed (N,), given those of all vehicles (N, V + 1); a relative one is never below 0."""
    value = table[:, target.value]
    if target.other < 0:
        return value
    theirs = speeds[:, target.other]
    return np.maximum(value * theirs if target.factor else value + theirs, 0.0)


def _order(needs: Sequence[Sequence[int]]) -> list[int]:
    # Vehicles such that each comes after those that it is relative to.
    order: list[int] = []
    waiting = list(range(len(needs)))
    while waiting:
        ready = [k for k in waiting if set(needs[k]) <= set(order)]
        if not ready:
            raise UsageError("the starts of vehicles are relative to each other in a circle")
        order += ready
        waiting = [k for k in waiting if k not in order]
    return order


def move_along_body(
    roads: RoadMap, s: Floats, d: Floats, heading: Floats, by: Floats | float
) -> tuple[Floats, Floats, Floats]:
    """Return poses that are ``by`` further ahead along the bodies, which are straight where roads bend."""
    along, across = by * np.cos(heading), by * np.sin(heading)
    line = roads.road.line
    if line is None:
        return s + along, d + across, heading
    moved = line.advance(s, d + 0.5 * across, along)
    bend = line.heading(moved) - line.heading(s)
    return moved, d + by * np.sin(heading - 0.5 * bend), heading - bend


def move_all(maps: Sequence[RoadMap], vehicles: Vehicles, ahead: Floats) -> Vehicles:
    """Return vehicles (N, V), each moved along its body by ``ahead`` (V,)."""
    poses = [
        move_along_body(roads, vehicles.x[:, k], vehicles.y[:, k], vehicles.heading[:, k], ahead[k])
        for k, roads in zip(range(vehicles.x.shape[1]), maps, strict=False)
    ]
    if not poses:
        return vehicles
    s, d, heading = (np.stack(values, axis=1) for values in zip(*poses, strict=True))
    return replace(vehicles, x=s, y=d, heading=heading)


def pick(vehicles: Vehicles, columns: int | slice) -> Vehicles:
    """Return one of all vehicles (N, V), or some of them."""
    return Vehicles(*(values[:, columns] for values in vars(vehicles).values()))


def move_over(vehicles: Vehicles, old: RoadMap, new: RoadMap) -> Vehicles:
    """Return vehicles, given along a road, along another one; NaN where they have no foot on it."""
    if old is new:
        return vehicles
    s, d = new.line.to_road(*old.line.to_plane(vehicles.x, vehicles.y))
    heading = vehicles.heading + old.line.heading(vehicles.x) - new.line.heading(s)
    return replace(vehicles, x=s, y=d, heading=heading)


def place_point(
    place: Place, roads: RoadMap, maps: Sequence[RoadMap], table: Floats, others: dict[int, Pose]
) -> Pose:
    """Return station, offset and heading (N,) of one place along a road."""
    base = maps[place.other] if place.other >= 0 else place.roads or roads
    s, d, heading = _place_on(place, base, maps, table, others)
    if base is roads:
        return s, d, heading
    turned = heading + base.line.heading(s)
    s, d = roads.line.to_road(*base.line.to_plane(s, d))
    return s, d, turned - roads.line.heading(s)


def _place_on(
    place: Place, roads: RoadMap, maps: Sequence[RoadMap], table: Floats, others: dict[int, Pose]
) -> Pose:
    x, y, heading = (table[:, number] for number in (place.x, place.y, place.heading))
    if place.kind in ("plane", "curve"):
        if place.curve is not None:
            path = build_path(place.curve, roads, maps, table, others)
            at_x, at_y, along = path.at(x)
            x, y = at_x - y * np.sin(along), at_y + y * np.cos(along)
            heading = heading if place.absolute else heading + along
        s, d = roads.line.to_road(x, y)
        return s, d, heading - roads.line.heading(s)
    if place.kind == "road":
        s, d = x, y
    elif place.kind == "lane":
        assert place.lane is not None
        s, d = x, y + lane_middle(roads, np.full(len(x), place.lane), x)
    else:
        their_s, their_d, their_heading = others[place.other]
        along = lane_direction(roads, their_d, their_s)
        if place.kind == "ahead":
            s, d, bent = move_along_body(roads, their_s, their_d, their_heading, x)
            s, d, _ = move_along_body(roads, s, d, bent + 0.5 * np.pi, y)
            return s, d, heading - roads.line.heading(s) if place.absolute else bent + heading
        if place.kind == "shifted":
            their_x, their_y = roads.line.to_plane(their_s, their_d)
            s, d = roads.line.to_road(their_x + x, their_y + y)
            turned = heading - roads.line.heading(s) if place.absolute else their_heading + heading
            return s, d, turned
        if place.lane is None:
            s, d = their_s + x, their_d + y
        else:
            lane = nearest_lane(roads, their_d, their_s) + (along * place.lane).astype(np.int64)
            s = their_s + (along if place.by_lane else 1.0) * x
            inside = np.clip(lane, 0, len(roads.road.lane_centres) - 1)  # others are as wide as its lanes
            d = lane_middle(roads, inside, s) + (lane - inside) * roads.road.lane_width + y
    if place.absolute:
        return s, d, heading - roads.line.heading(s)
    if place.turned and place.kind != "lane":
        return s, d, heading  # against the reference line, not the lane
    opposing = lane_direction(roads, d, s) < 0.0
    if place.kind == "lane":
        opposing = np.full(len(s), place.lane in roads.road.opposing)
    return s, d, heading + np.where(opposing, np.pi, 0.0)


def build_path(
    curve: Trajectory, roads: RoadMap, maps: Sequence[RoadMap], table: Floats, others: dict[int, Pose]
) -> Path:
    """Return the points of a trajectory in the plane."""
    poses = []
    for vertex in curve.vertices:
        s, d, heading = place_point(vertex, roads, maps, table, others)
        poses.append((*roads.line.to_plane(s, d), heading + roads.line.heading(s)))
    return Path.build(curve, poses)
