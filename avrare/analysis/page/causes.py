"""Causes of failure: kinds with their probabilities and pictures, and savings by perfect parts."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from avrare.analysis.page.model import Car, Causes, Command, Kind, Kinds, Picture
from avrare.analysis.page.player import name_rollout
from avrare.analysis.page.stored_rollouts import MonitoredRollout
from avrare.base.chart import Chart, Points, make_linear_scale
from avrare.base.number_format import describe_share
from avrare.driving import Road, Vehicles, World
from avrare.driving.lanes import lane_borders, lane_exists, list_markings
from avrare.driving.values import to_plane
from avrare.estimation.result.result import Result
from avrare.protocols import Floats
from avrare.results.run import Run
from avrare.results.stored_causes import StoredCauses, StoredKind, StoredKinds

_BEHIND, _AHEAD = 30.0, 50.0
"""Stretch of road around the ego that is drawn [m]."""
_STYLES = 6
"""Colours of kinds; the seventh kind has that of the first."""


def build_causes(
    run: Run, result: Result, stored: StoredCauses, rollouts: Sequence[MonitoredRollout] = ()
) -> Causes | None:
    """Collect the known causes of failure; None without failures.

    ``rollouts`` are those that the report shows.
    """
    if not result.failures.count or run.folder is None:
        return None
    if stored.problem:
        return Causes(stored.problem)
    name = result.specification
    kinds, attribution = stored.kinds.get(name), stored.attribution.get(name)
    return Causes(
        "",
        None if kinds is None else _build_kinds(name, kinds, rollouts),
        () if attribution is None else tuple((saving.perfect, saving.text) for saving in attribution.perfect),
        _write_command(run, name, kinds is not None),
    )


def summarise_causes(name: str, stored: StoredCauses) -> list[str]:
    """Describe the failures of a specification and their remedies."""
    kinds, attribution = stored.kinds.get(name), stored.attribution.get(name)
    sentences = []
    for kind in kinds.kinds[:2] if kinds is not None else ():
        often = "" if kind.share > 0.999 else f" in {describe_share(kind.share)} of them"
        severity = f" {_capitalise(kind.severity)}." if kind.severity else ""
        cause = kind.cause or "no noise that differs from chance"
        sentences.append(f"Cause{often}: {cause}. What happens: {kind.text}.{severity}")
    if attribution is not None and attribution.perfect:
        best = attribution.perfect[0]
        sentences.append(f"What helps most: {best.perfect} {best.text}.")
    analyses = (("the causes", kinds), ("what would help", attribution))
    missing = " and ".join(name for name, analysis in analyses if analysis is None)
    return [*sentences, f"Not looked for: {missing}."] if missing else sentences


def _write_command(run: Run, name: str, analysed: bool) -> Command:
    words = ["avrare", "why", str(run.folder), "--specification", name, "--out", str(run.folder), "--shrink"]
    text = "Not analysed. To add them to this report, run this and write the report again:"
    title = "The command" if analysed else "Kinds of failure, and what to fix first"
    return Command(title, "" if analysed else text, shlex.join(words))


def _build_kinds(name: str, kinds: StoredKinds, rollouts: Sequence[MonitoredRollout]) -> Kinds:
    replays = {rollout.stored.index: rollout for rollout in rollouts if rollout.stored.specification == name}
    cards = [_build_kind(name, kind, replays.get(kind.representative)) for kind in kinds.kinds]
    return Kinds(tuple(cards), draw_map(kinds))


def _build_kind(name: str, kind: StoredKind, rollout: MonitoredRollout | None) -> Kind:
    sentences = (
        f"Cause, on average: {kind.cause}." if kind.cause else "",
        f"{_capitalise(kind.severity)}." if kind.severity else "",
        f"It needs only this: {kind.decisive}." if kind.decisive else "",
        f"{_capitalise(kind.lost)}." if kind.lost else "",
    )
    return Kind(
        kind.kind,
        (kind.kind - 1) % _STYLES,
        kind.probability,
        (kind.low, kind.high),
        describe_share(kind.share),
        kind.text,
        kind.representative,
        "" if rollout is None else name_rollout(name, kind.representative),
        tuple(filter(None, sentences)),
        tuple(f"{_capitalise(text)}." for text in kind.warnings),
        None if rollout is None else draw_moment(rollout),
    )


def _capitalise(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


def draw_moment(rollout: MonitoredRollout) -> Picture | None:
    """Return the first violation, or the decisive sample, seen from above; None without vehicles.

    A road that bends is drawn in the plane, turned so that it leads to the right where the ego is.
    """
    result = rollout.result
    decisive = None if result is None else result.first or result.worst
    if result is None or decisive is None or not rollout.frames or result.recording.scene is None:
        return None
    scene, at = result.recording.scene, decisive.sample
    view = _View(scene.road, float(rollout.frames[at].world.ego.x[0]))
    lanes, lines, low, high = _draw_road(view, scene.road)
    first = max(at - round(3.0 / result.recording.dt), 0)  # paths of the last 3 s
    trail = [view.place(frame.world) for frame in rollout.frames[first : at + 1]]
    names = set(decisive.vehicles.values())
    cars = []
    for v, name in enumerate(scene.names):
        style = "decides" if name in names else "other"
        size = float(scene.lengths[v]), float(scene.widths[v])
        cars.append(_draw_vehicle([others for _, others in trail], (0, v), size, style, name))
    ego = float(scene.ego_length), float(scene.ego_width)
    cars.append(_draw_vehicle([vehicle for vehicle, _ in trail], (0,), ego, "ego", "ego"))
    moment = "first violation" if result.first is not None else "least robustness"
    return Picture(
        f"The road at {result.recording.time(at):.1f} s, at the {moment}",
        (0.0, -high - 2.5, _BEHIND + _AHEAD, high - low + 5.0),
        lanes,
        lines,
        tuple(car for car in cars if car is not None),
    )


class _View:
    """Plane of the picture, in which the road leads to the right at one station.

    Attributes:
        stations: x of the road's points that are drawn.
    """

    def __init__(self, road: Road, x: float) -> None:
        self._road, self._x = road, np.array([x])
        steps = 2 if road.line is None and not road.lanes else 81
        self.stations = np.linspace(x - _BEHIND, x + _AHEAD, steps)

    def _turn(self, vehicles: Vehicles) -> Vehicles:
        if self._road.line is None:
            return replace(vehicles, x=vehicles.x - self._x[0] + _BEHIND)
        x, y, heading, _ = (field[0] for field in self._road.line.frame(self._x))
        plane = to_plane(self._road, vehicles)
        ahead, aside = plane.x - x, plane.y - y
        cos, sin = np.cos(heading), np.sin(heading)
        return replace(
            plane,
            x=ahead * cos + aside * sin + _BEHIND,
            y=aside * cos - ahead * sin,
            heading=plane.heading - heading,
        )

    def place(self, world: World) -> tuple[Vehicles, Vehicles]:
        """Return ego and others in the picture; y is still to the left."""
        return self._turn(world.ego), self._turn(world.others)

    def curve(self, x: Floats, y: Floats) -> Floats:
        """Return points (K, 2) of the road in the picture, y downwards."""
        zeros = np.zeros_like(x)
        placed = self._turn(Vehicles(x, y, zeros, zeros, zeros))
        return np.stack([placed.x, -placed.y], axis=1)


def _draw_road(view: _View, road: Road) -> tuple[tuple[Points, ...], tuple[Points, ...], float, float]:
    # Lanes as far as they are there, then the lines between them; and the least and greatest y to the left.
    surfaces, lines, reach = [], [], []
    exists = lane_exists(road, view.stations)
    right, left = (np.broadcast_to(border, exists.shape) for border in lane_borders(road, view.stations))
    for lane in np.flatnonzero(exists.sum(axis=1) > 1).tolist():
        x = view.stations[exists[lane]]
        borders = [view.curve(x, border[lane][exists[lane]]) for border in (right, left)]
        surfaces.append(_list_points([*borders[0], *borders[1][::-1]]))
        reach += [points[:, 1] for points in borders]
    for marking in (marking for marking in list_markings(road) if marking.inner):
        x = view.stations[(view.stations >= marking.x[0]) & (view.stations <= marking.x[-1])]
        if len(x) > 1:
            lines.append(_list_points(view.curve(x, np.interp(x, marking.x, marking.y))))
    if not reach:
        return (), (), 0.0, 0.0
    coordinates = np.concatenate(reach)
    return tuple(surfaces), tuple(lines), -float(coordinates.max()), -float(coordinates.min())


def _list_points(points: Iterable[Floats]) -> Points:
    return tuple((float(x), float(y)) for x, y in points)


def _draw_vehicle(
    trail: Sequence[Vehicles], at: tuple[int, ...], size: tuple[float, float], style: str, name: str
) -> Car | None:
    points = [np.array([vehicles.x[at], -vehicles.y[at]]) for vehicles in trail]
    x, y = points[-1].tolist()
    if not -size[0] <= x <= _BEHIND + _AHEAD + size[0]:
        return None
    turn = -math.degrees(float(trail[-1].heading[at]))
    return Car(name, style, x, y, turn, *size, trail=_list_points(points))


def draw_map(kinds: StoredKinds) -> Chart | None:
    """Return all failures in the plane of their principal components, a colour for each kind."""
    if len(kinds.points) < 3 or len(kinds.points) != len(kinds.labels):
        return None
    points, labels = np.array(kinds.points), np.array(kinds.labels)
    if not np.ptp(points, axis=0).all():
        return None
    x, y = (make_linear_scale(points[:, axis].tolist()) for axis in (0, 1))
    numbers = sorted(set(labels.tolist()))
    chart = Chart(
        x,
        y,
        f"{len(points)} failures in the plane of their two principal components",
        caption="The failures: near ones are alike",
        height=140,
        bare=True,
        legend=tuple((f"dot kind-{number % _STYLES}", f"kind {number + 1}") for number in numbers),
    )
    for number in numbers:
        chosen = points[labels == number]
        chart = chart.dots(chosen[:, 0], chosen[:, 1], f"kind-{number % _STYLES}")
    return chart
