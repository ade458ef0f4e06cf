"""Intersections of a lanelet network on the way of one vehicle: stop signs, lights, and who has priority.

Only attributes of commonroad-io's networks are read. A way through an intersection is a lanelet that follows
an incoming one; the ego's is the one it drives on, so that its direction is observed, not guessed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Crossing, Road
from avrare.driving.values import GREEN, RED, YELLOW
from avrare.protocols import Floats
from avrare_recordings.roads.ways import Way, find_crossing

if TYPE_CHECKING:
    from commonroad.scenario.intersection import IncomingGroup
    from commonroad.scenario.lanelet import Lanelet, LaneletNetwork
    from commonroad.scenario.traffic_light import TrafficLight

_PRIORITY = {"PRIORITY": 2, "RIGHT_OF_WAY": 2, "YIELD": 0, "STOP": -1}
"""Rank of an incoming lanelet by its sign; 1 without one."""
_TURNS = ("left", "straight", "right")


def has_right_of_way(network: LaneletNetwork) -> bool:
    """Return whether a network has intersections, stop signs or traffic lights."""
    lanelets = network.lanelets
    return bool(network.intersections) or any(
        "STOP" in _signs(network, lanelet) or lanelet.traffic_lights for lanelet in lanelets
    )


def check_references(path: str, network: LaneletNetwork) -> None:
    """Raise UsageError if a network refers to signs, lights or lanelets that it does not have."""
    lanelets = {int(lanelet.lanelet_id) for lanelet in network.lanelets}
    for lanelet in network.lanelets:
        signs, lights = sorted(lanelet.traffic_signs or ()), sorted(lanelet.traffic_lights or ())
        missing = [f"sign {sign}" for sign in signs if network.find_traffic_sign_by_id(sign) is None]
        missing += [f"light {light}" for light in lights if network.find_traffic_light_by_id(light) is None]
        if missing:
            text = (
                f"{path}: lanelet {lanelet.lanelet_id} refers to the traffic {missing[0]}, which is not there"
            )
            raise UsageError(text, "add it to the file, or delete the reference")
    for intersection in network.intersections:
        incoming = {int(name) for group in intersection.incomings for name in group.incoming_lanelets or ()}
        if unknown := sorted(incoming - lanelets):
            text = (
                f"{path}: intersection {intersection.intersection_id} has the incoming lanelet {unknown[0]}"
            )
            raise UsageError(f"{text}, which is not there", "mend the intersection")
    for light in network.traffic_lights:
        if light.active and sum(phase.duration for phase in light.traffic_light_cycle.cycle_elements) <= 0:
            text = f"{path}: the cycle of traffic light {light.traffic_light_id} takes no time"
            raise UsageError(text, "its durations are numbers of steps")


def add_crossings(
    road: Road, network: LaneletNetwork, names: Sequence[int], routes: Sequence[Sequence[int]]
) -> Road:
    """Return the road of an ego with the stop signs, the lights and the conflict areas on its way.

    Args:
        road: Road along these lanelets, with a line.
        network: Network of commonroad-io.
        names: Successive lanelets of the ego's way.
        routes: Those of each other vehicle.
    """
    assert road.line is not None
    lanelets = _index_lanelets(network)
    crossings: list[Crossing] = []
    for intersection in network.intersections:
        groups = [list(_list_ways(network, lanelets, group)) for group in intersection.incomings]
        for k, group in enumerate(groups):
            for ego_way in (way for way in group if way.name in names):
                for other in (way for rest in (*groups[:k], *groups[k + 1 :]) for way in rest):
                    if (area := find_crossing(road.line, ego_way, other)) is not None:
                        users = tuple(k for k, route in enumerate(routes) if other.name in route)
                        crossings.append(dataclasses.replace(area, users=users))
    stops = [_stop_line(lanelets[name]) for name in names if "STOP" in _signs(network, lanelets[name])]
    halts = [_stop_line(lanelets[name]) for name, _ in _list_lights(network, names)]
    signs, lights = (
        tuple(float(road.line.to_road(*point[:, None])[0][0]) for point in points)
        for points in (stops, halts)
    )
    return dataclasses.replace(
        road, stop_signs=tuple(sorted(signs)), crossings=tuple(crossings), light_lines=lights
    )


def show_lights(network: LaneletNetwork, names: Sequence[int], steps: Sequence[int]) -> dict[str, Floats]:
    """Return the signals ``light_0``, ... (T,) of the lights on the ego's way, in the order of its road."""
    return {
        f"light_{k}": np.array([max(_colour(light, step) for light in lights) for step in steps])
        for k, (_, lights) in enumerate(_list_lights(network, names))
    }


def _list_lights(network: LaneletNetwork, names: Sequence[int]) -> list[tuple[int, list[TrafficLight]]]:
    # lanelets of the ego's way with the lights that are meant for its direction
    lanelets, lights_by_name = _index_lanelets(network), []
    for name in names:
        turn, lanelet = _turn(network, name, names), lanelets[name]
        arrow = turn == "right" and "GREEN_ARROW" in _signs(network, lanelet)
        all_lights = map(network.find_traffic_light_by_id, sorted(lanelet.traffic_lights or ()))
        lights = [light for light in all_lights if light.active and _applies_to(light, turn)]
        if lights and not arrow:
            lights_by_name.append((name, lights))
    return lights_by_name


def _index_lanelets(network: LaneletNetwork) -> dict[int, Lanelet]:
    return {int(lanelet.lanelet_id): lanelet for lanelet in network.lanelets}


def _turn(network: LaneletNetwork, name: int, names: Sequence[int]) -> str:
    # where the ego's way leads from an incoming lanelet
    groups = [group for intersection in network.intersections for group in intersection.incomings]
    ways = (
        (turn, _outgoing(group, turn))
        for group in groups
        if name in (group.incoming_lanelets or ())
        for turn in _TURNS
    )
    return next((turn for turn, after in ways if after & set(names)), "straight")


def _applies_to(light: TrafficLight, turn: str) -> bool:
    direction = str(light.direction.value)
    return direction == "all" or turn in direction.lower()


def _colour(light: TrafficLight, step: int) -> float:
    state = str(light.get_state_at_time_step(step).value)
    return {"red": RED, "redYellow": RED, "yellow": YELLOW}.get(state, GREEN)


def _list_ways(
    network: LaneletNetwork, by_id: Mapping[int, Lanelet], incoming: IncomingGroup
) -> Iterator[Way]:
    for name in sorted(incoming.incoming_lanelets or ()):
        lanelet = by_id[int(name)]
        ranks = [_PRIORITY[sign] for sign in _signs(network, lanelet) if sign in _PRIORITY]
        x, y = np.diff(np.asarray(lanelet.center_vertices)[-2:, :2], axis=0)[0]
        lights = [network.find_traffic_light_by_id(each) for each in lanelet.traffic_lights or ()]
        for after in sorted(set(lanelet.successor or ()) & set(by_id)):
            turn = next((turn for turn in _TURNS if after in _outgoing(incoming, turn)), "")
            yield Way(
                int(after),
                np.asarray(by_id[after].left_vertices)[:, :2],
                np.asarray(by_id[after].right_vertices)[:, :2],
                min(ranks, default=1),
                math.atan2(y, x),
                turn,
                any(light.active for light in lights),
            )


def _outgoing(incoming: IncomingGroup, turn: str) -> set[int]:
    return set(getattr(incoming, f"outgoing_{turn}") or ())


def _signs(network: LaneletNetwork, lanelet: Lanelet) -> set[str]:
    signs = (network.find_traffic_sign_by_id(number) for number in lanelet.traffic_signs or ())
    return {str(part.traffic_sign_element_id.name) for sign in signs for part in sign.traffic_sign_elements}


def _stop_line(lanelet: Lanelet) -> Floats:
    # the middle of the line, or of the lanelet's end where the file gives no line
    line = lanelet.stop_line
    if line is None or line.start is None or line.end is None:
        return np.asarray(lanelet.center_vertices)[-1, :2]
    return np.asarray(0.5 * (np.asarray(line.start)[:2] + np.asarray(line.end)[:2]))
