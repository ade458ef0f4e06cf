"""Reading of an OpenSCENARIO file: entities, road, starts, and the storyboard as values."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from avrare.base.errors import did_you_mean
from avrare_openscenario.action_reader import ActionReader
from avrare_openscenario.catalogs import Catalogs
from avrare_openscenario.lanelet_map import is_lanelet_map, read_lanelet_map
from avrare_openscenario.network import Network, RoadMap, open_plane
from avrare_openscenario.opendrive import read_opendrive
from avrare_openscenario.parameters import Number, Parameters
from avrare_openscenario.routes import add_crossings, follow_lane
from avrare_openscenario.signals import Signals
from avrare_openscenario.starts import nearest_lane, place_all, speed_all
from avrare_openscenario.story import (
    Action,
    Gap,
    Place,
    Route,
    SpeedChange,
    Starts,
    Storyboard,
    TargetSpeed,
    Teleport,
    Trajectory,
    Transition,
)
from avrare_openscenario.story_reader import StoryReader
from avrare_openscenario.xml_tree import Element, read_xml


@dataclass(frozen=True)
class Body:
    """Body of a vehicle.

    Attributes:
        name: Name of the entity.
        length: [m].
        width: [m].
        ahead: Distance of its middle ahead of the middle of the rear axle, its point of reference [m].
        wheelbase: Distance of the axles [m]; None where there are no axles.
        speed_max: Top speed [m/s].
        rates: Highest acceleration and deceleration of a change of speed [m/s^2].
        kind: ``Vehicle``, ``Pedestrian`` or ``MiscObject``.
    """

    name: str
    length: float
    width: float
    ahead: float
    wheelbase: float | None
    speed_max: float | None
    rates: tuple[float, float]
    kind: str


@dataclass(frozen=True)
class ScenarioFile:
    """Scene of a file.

    Attributes:
        path: The file.
        road_path: The file of its road; empty: none.
        catalog_paths: The files of the catalogs that it refers to.
        parameters: Its parameters; all numbers of the storyboard are columns of their table.
        network: All roads.
        maps: The road on which each vehicle starts, that of the ego last.
        bodies: Bodies of the vehicles, the ego last.
        ego: Whether the last one is an ego that a stack drives; else all obey the file.
        reverses: Whether that begins in reverse gear; a stack drives it with its tail as its front.
        story: What happens.
        notes: What is left out, with its places.
    """

    path: str
    road_path: str
    catalog_paths: tuple[str, ...]
    parameters: Parameters
    network: Network
    maps: tuple[RoadMap, ...]
    bodies: tuple[Body, ...]
    ego: bool
    reverses: bool
    story: Storyboard
    notes: tuple[str, ...]


def read_scenario(
    path: str,
    ego: str | None,
    dt: float,
    given: Mapping[str, float | str],
    road: str | None = None,
    ignore_ego: bool = False,
    catalogs: Sequence[str] = (),
    allowed: Callable[[str, str], None] | None = None,
) -> ScenarioFile:
    """Read a file.

    Args:
        path: The file.
        ego: Name of the entity that is the ego; None: all entities obey the storyboard.
        dt: Step [s].
        given: Values of parameters, in place of the declared ones.
        road: Road file in place of the one that the file names.
        ignore_ego: Whether what the storyboard has the ego do is passed over.
        catalogs: Files of catalogs in place of those in the folders that the file names; empty: those.
        allowed: Raises an error where a file (path, what it is) may not be read.

    Raises:
        UsageError: Something is not understood, with its place.
    """
    top = read_xml(path, "OpenSCENARIO")
    header = top.child("FileHeader")
    header.skip()
    if header.attributes.get("revMajor") != "1":
        raise header.error("only OpenSCENARIO XML 1.x is read")
    parameters = Parameters(top.find("ParameterDeclarations"), given, path)
    entries = Catalogs(top.find("CatalogLocations"), parameters, catalogs, allowed)
    top.skip_children("MonitorDeclarations")
    named = top.child("RoadNetwork")
    file, roads = _read_roads(named, parameters, road, allowed)
    if ego is not None and not file:
        raise named.error("names no LogicFile", "the lanes must be known")
    entities = top.child("Entities")
    bodies = _read_bodies(entities, parameters, entries, ego)
    names = [body.name for body in bodies]
    board = top.child("Storyboard")
    kinds = [body.kind for body in bodies]
    driven = None if ego is None else len(names) - 1
    lights = Signals(named.find("TrafficSignals"), parameters, _read_variables(top, parameters))
    reader = ActionReader(parameters, roads, names, kinds, entries, lights)
    reader.read_selections(entities)
    starts = _read_starts(board.child("Init"), reader, board.list_names("Actors", "entityRef"))
    storyboard = StoryReader(reader, dt, driven, ignore_ego)
    story = storyboard.read(board, starts)
    top.refuse_unread()
    entries.refuse_unread()
    notes = (*top.notes(), *entries.notes(), *roads.notes)
    maps = _find_roads(story, roads, parameters)
    reverses = ego is not None and bool(speed_all(story, parameters.table({}, 1))[0, -1] < 0.0)
    if ego is not None:
        maps = _follow_ways(story, roads, maps, starts.routes, parameters, reverses)
    if reverses:
        bodies = (*bodies[:-1], replace(bodies[-1], ahead=-bodies[-1].ahead))
    return ScenarioFile(
        path,
        file,
        tuple(entries.used),
        parameters,
        roads,
        maps,
        bodies,
        ego is not None,
        reverses,
        story,
        notes,
    )


def _read_roads(
    block: Element, parameters: Parameters, road: str | None, allowed: Callable[[str, str], None] | None
) -> tuple[str, Network]:
    # The road file, empty where there is none, and its roads.
    block.skip_children("SceneGraphFile", "UsedArea")
    logic = block.find("LogicFile")
    if logic is None and road is None:
        block.note("names no road: vehicles move in the open plane")
        return "", open_plane()
    element = logic or block
    file = road or parameters.path(element, "filepath")
    element.ignore("filepath")
    if allowed is not None:
        allowed(file, "RoadNetwork: LogicFile")
    if not os.path.isfile(file):
        raise element.error(f"there is no road file {file}", "name it with the option `road`")
    return file, read_lanelet_map(file, element) if is_lanelet_map(file) else read_opendrive(file)


def _find_roads(story: Storyboard, roads: Network, parameters: Parameters) -> tuple[RoadMap, ...]:
    # The road on which each vehicle starts.
    def find(place: Place, asked: tuple[int, ...] = ()) -> RoadMap:
        if place.roads is not None or len(roads.maps) == 1:
            return place.roads or roads.maps[0]
        if place.other >= 0 and place.other not in asked:
            return find(story.places[place.other], (*asked, place.other))
        if place.curve is not None:
            return find(place.curve.vertices[0], asked)
        x, y = parameters.table({}, 1)[0, [place.x, place.y]]
        return roads.find_nearest(x, y)

    return tuple(find(place) for place in story.places)


def _follow_ways(
    story: Storyboard,
    network: Network,
    maps: tuple[RoadMap, ...],
    routes: Mapping[int, Sequence[RoadMap]],
    parameters: Parameters,
    reverses: bool,
) -> tuple[RoadMap, ...]:
    # The way of each vehicle, through junctions where its road ends at one; in reverse gear against its road.
    ways = list(maps)
    stations, offsets, headings = place_all(story, maps, parameters.table({}, 1))
    for k, roads in enumerate(maps):
        backs = reverses and k == len(maps) - 1
        direction = 1 if (np.cos(headings[0, k]) >= 0.0) != backs else -1
        leads_on = backs or network.find_ways(roads, direction)
        if roads.lanes and leads_on and np.isfinite(stations[0, k]):
            lane = roads.name_lane(int(nearest_lane(roads, offsets[:, k], stations[:, k])[0]))
            ways[k] = follow_lane(network, roads, lane, routes.get(k, ()), direction)
    for k, place in enumerate(story.places[:-1]):  # a curve may begin beyond its road
        if place.curve is not None and not 0.0 <= stations[0, k] <= ways[k].line.length:
            ways[k] = ways[-1]
    ways[-1] = add_crossings(network, ways[-1])
    passed = [[(leg.roads, leg.direction) for leg in way.legs] for way in ways]
    pairs = zip(ways, passed, strict=True)
    return tuple(ways[-1] if legs and legs == passed[-1] else way for way, legs in pairs)


def _read_bodies(
    entities: Element, parameters: Parameters, catalogs: Catalogs, ego: str | None
) -> tuple[Body, ...]:
    bodies = [_read_body(entity, parameters, catalogs) for entity in entities.list("ScenarioObject")]
    names = [body.name for body in bodies]
    if not names:
        raise entities.error("has no ScenarioObject")
    if ego is not None and ego not in names:
        hint = did_you_mean(ego, names) or f"choose it with `entity`; there are: {', '.join(names)}"
        raise entities.error(f"there is no entity {ego!r}", hint)
    if ego is not None and (wrong := sorted({"ego", "others"} & {name for name in names if name != ego})):
        raise entities.error(f"{wrong[0]!r} is a reserved name in formulas", "give the entity another name")
    if len(set(names)) < len(names):
        raise entities.error("two entities have the same name")
    return (*(body for body in bodies if body.name != ego), *(body for body in bodies if body.name == ego))


def _read_body(entity: Element, parameters: Parameters, catalogs: Catalogs) -> Body:
    entity.skip_children("ObjectController")
    tags = ("Vehicle", "Pedestrian", "MiscObject")
    kind = entity.choice(*tags, "CatalogReference")
    if kind.tag == "CatalogReference":
        kind = catalogs.resolve(kind, tags)
    if kind.path == entity.path:
        parameters.declare(kind.find("ParameterDeclarations"))
    box = kind.child("BoundingBox")
    box.skip()
    centre, size = box.child("Center"), box.child("Dimensions")
    kind.skip_children("Properties", "ParameterDeclarations", "TrailerHitch", "TrailerCoupler")
    for trailer in kind.list("Trailer"):
        trailer.pass_over("trailers are left out")
    kind.ignore(*kind.attributes)

    read = parameters.read_number
    top_speed, rates, performance = None, (np.inf, np.inf), kind.find("Performance")
    if performance is not None:
        performance.skip()
        top_speed = read(performance, "maxSpeed")
        rates = read(performance, "maxAcceleration"), read(performance, "maxDeceleration")
    wheelbase, axles = None, kind.find("Axles")
    if axles is not None:
        axles.skip()
        front = axles.find("FrontAxle")  # a trailer has none
        if front is not None:
            wheelbase = read(front, "positionX") - read(axles.child("RearAxle"), "positionX")
    if "y" in centre.attributes and read(centre, "y") != 0.0:
        raise centre.error("the box should lie in the middle of the vehicle: y = 0")
    length, width = read(size, "length"), read(size, "width")
    if min(length, width) <= 0.0:
        raise size.error("length and width should be above 0")
    name = parameters.text(entity, "name")
    return Body(name, length, width, read(centre, "x"), wheelbase, top_speed, rates, kind.tag)


def _read_starts(init: Element, reader: ActionReader, acting: set[str]) -> Starts:
    places: dict[int, Place] = {}
    speeds: dict[int, TargetSpeed] = {}
    adjustments: list[Gap | Teleport] = []
    later: list[Action] = []
    routes: dict[int, Sequence[RoadMap]] = {}
    for actions in init.list("Actions"):
        for kind in (*actions.list("GlobalAction"), *actions.list("UserDefinedAction")):
            later += [action for action in [reader.read_global(kind)] if action is not None]
        for private in actions.list("Private"):
            members, deeds = reader.find_members(private), private.list("PrivateAction")
            for actor, deed in product(members, deeds):
                match reader.read_private(deed, actor):
                    case Route(roads=wanted):
                        routes[actor] = wanted
                    case Teleport(place=place) as teleport:
                        if place.other == actor:  # from where it was put before
                            adjustments.append(teleport)
                        else:
                            places[actor] = place
                    case SpeedChange(transition=Transition(form="step"), continuous=False, target=speed):
                        speeds[actor] = speed
                    case Gap(acceleration=None, across=False) as gap:
                        adjustments.append(gap)
                        later += [gap] if gap.continuous else []
                    case action if action is not None:
                        later.append(action)
    curves = {action.actor: action for action in later if isinstance(action, Trajectory)}
    for actor, name in enumerate(reader.names):
        if actor not in places and actor in curves:  # it begins where its trajectory does
            places[actor] = _begin_curve(curves[actor], speeds.get(actor), reader.parameters)
        if actor not in places and name in acting:  # it moves later
            nothing = reader.parameters.constant(0.0)
            places[actor] = Place("plane", nothing, nothing, nothing, absolute=True)
            init.note(f"{name!r} has no start: it waits at the origin")
        if actor not in places:
            raise init.error(f"{name!r} has no start", "give it a TeleportAction")
    still = TargetSpeed(reader.parameters.constant(0.0))
    every = range(len(reader.names))
    return Starts(
        tuple(places[actor] for actor in every),
        tuple(speeds.get(actor, still) for actor in every),
        tuple(adjustments),
        tuple(later),
        routes,
    )


def _begin_curve(curve: Trajectory, speed: TargetSpeed | None, parameters: Parameters) -> Place:
    # Place at the begin of a trajectory, against it where that begins in reverse gear.
    nothing = parameters.constant(0.0)
    backs = speed is not None and parameters.table({}, 1)[0, speed.value] < 0.0
    heading = parameters.constant(np.pi) if backs and curve.may_reverse else nothing
    return Place("curve", nothing if curve.begin is None else curve.begin, nothing, heading, curve=curve)


def _read_variables(top: Element, parameters: Parameters) -> dict[str, Number]:
    # Value of each parameter and variable at the start, as conditions see them.
    variables: dict[str, Number] = {}
    for tag in ("ParameterDeclaration", "VariableDeclaration"):
        declarations = top.find(f"{tag}s")
        for element in declarations.list(tag) if declarations is not None else ():
            element.get("variableType")
            variables[element.attribute("name")] = parameters.value(element, "value")
    return variables
