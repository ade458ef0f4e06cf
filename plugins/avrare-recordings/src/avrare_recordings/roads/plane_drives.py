"""Vehicles recorded in the plane, any of which can be the ego, on the lanes of a network or of the caller."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.driving.reference_line import ReferenceLine
from avrare.protocols import Floats
from avrare.results.recordings import FIELDS, Recording, VehicleTrack, assemble_recording
from avrare_recordings.roads.crossings import add_crossings, check_references, has_right_of_way, show_lights
from avrare_recordings.roads.lanelet_road import ASIDE, find_neighbours, find_path
from avrare_recordings.roads.lanelet_road import find_road as find_lanelet_road
from avrare_recordings.roads.straight_road import find_straight_lanes, rotate


@dataclass(frozen=True)
class PlaneDrives:
    """Drives in whose traffic any moving obstacle can be the ego.

    Attributes:
        path: File.
        dt: Step [s].
        obstacles: Obstacles by name, in the plane.
        names: The moving ones.
        lanelets: The network.
        road: Road for an ego on no lanelets that can be read; None: there is none.
        network: The network with its signs and intersections; None: they are unknown.
        light_step: Step of its light cycles, which begin with the recording [s]; None: ``dt``.
    """

    path: str
    dt: float
    obstacles: Mapping[str, Obstacle]
    names: tuple[str, ...]
    lanelets: tuple[Any, ...]
    road: Road | None = None
    network: Any = None
    light_step: float | None = None

    def recording(self, ego: str | None) -> Recording:
        """Return the drive of one ego; UsageError if it is not there, has gaps, or is on no road."""
        if ego not in self.names:
            names = ", ".join(self.names) or "none"
            text = "no ego is chosen" if ego is None else f"there is no moving obstacle {ego!r}"
            raise UsageError(f"{self.path}: {text}", f"choose the ego; there are: {names}")
        body = self.obstacles[ego]
        first, samples = int(body.steps.min()), int(body.steps.max() - body.steps.min()) + 1
        if len(set(body.steps.tolist())) < samples:  # or else one step far off makes arrays of any size
            raise UsageError(
                f"{self.path}: obstacle {ego} has gaps in time", "the ego needs a state at every step"
            )
        road, angle = self.find_road(body)
        tracks = {
            name: obstacle.track(first, samples, angle, road.line)
            for name, obstacle in self.obstacles.items()
        }
        if not tracks[ego].present.all():
            at = first + int(np.argmin(tracks[ego].present))
            text = f"{self.path}: obstacle {ego} leaves the road at step {at}"
            raise UsageError(text, f"it is more than {ASIDE:g} m from the line along its lanes")
        others = [track for name, track in tracks.items() if name != ego and track.present.any()]
        road, lights = self.add_rules(road, body, [track.name for track in others], first, samples)
        assembled = assemble_recording(self.path, self.dt, self.dt * first, tracks[ego], others, road)
        return dataclasses.replace(assembled, signals={**assembled.signals, **lights})

    def add_rules(
        self, road: Road, ego: Obstacle, others: Sequence[str], first: int, samples: int
    ) -> tuple[Road, dict[str, Floats]]:
        """Return the road of an ego with the intersections on its way, and the signals of its lights.

        Args:
            road: Its road.
            ego: The ego.
            others: Names of the other vehicles, in the order of the scene.
            first: Step of the first sample.
            samples: Number of samples.
        """
        if road is self.road or not self._has_right_of_way:
            return road, {}
        names = self._find_route(ego)
        road = add_crossings(road, self.network, names, [self._routes[name] for name in others])
        ratio = self.dt / (self.light_step or self.dt)
        steps = [math.floor(ratio * step + 1e-6) for step in range(first, first + samples)]
        return road, show_lights(self.network, names, steps)

    def find_road(self, ego: Obstacle) -> tuple[Road, float]:
        """Return the road of an ego, and the angle by which the plane is rotated if the road has no line."""
        try:
            if self._straight is not None:
                return self._straight
            return find_lanelet_road(self.path, self.lanelets, ego.states[:2].T, ego.states[2]), 0.0
        except UsageError:
            if self.road is None:
                raise
            return self.road, 0.0

    def lead(self, ego: Obstacle, route: Sequence[int]) -> Obstacle:
        """Return a vehicle that also drives along the lanelets ``route``; UsageError for a gap in them."""
        by_id = {int(lanelet.lanelet_id): lanelet for lanelet in self.lanelets}
        if unknown := sorted(set(route) - set(by_id)):
            raise UsageError(f"{self.path}: there is no lanelet {unknown[0]}", "look at `route`")
        states = [ego.states]
        for name in route:
            x, y = np.asarray(by_id[name].center_vertices)[:, :2].T
            middles = np.stack([0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1])])
            headings = np.arctan2(np.diff(y), np.diff(x))
            states.append(np.stack([*middles, headings, np.zeros_like(headings)]))
        x, y, headings, _ = joined = np.concatenate(states, axis=1)
        path = find_path(self.path, self.lanelets, np.stack([x, y], axis=1), headings) if route else []
        neighbours = [find_neighbours(by_id, name) for name in route]
        places = [next((k for k, name in enumerate(path) if name in each), -1) for each in neighbours]
        if -1 in places or places != sorted(places):
            text = f"{self.path}: the lanelets of `route` do not lead on from the ego's start"
            raise UsageError(text, "each follows the one before it: " + ", ".join(map(str, route)))
        return dataclasses.replace(ego, states=joined)

    @cached_property
    def _routes(self) -> Mapping[str, Sequence[int]]:
        # successive lanelets of every obstacle; none of those that stand beside the road
        return {name: self._find_route(obstacle) for name, obstacle in self.obstacles.items()}

    def _find_route(self, obstacle: Obstacle) -> Sequence[int]:
        try:
            return find_path(self.path, self.lanelets, obstacle.states[:2].T, obstacle.states[2])
        except UsageError:
            return ()

    @cached_property
    def _has_right_of_way(self) -> bool:
        if self.network is None:
            return False
        check_references(self.path, self.network)
        return has_right_of_way(self.network)

    @cached_property
    def _straight(self) -> tuple[Road, float] | None:
        if not self.lanelets:
            raise UsageError(f"{self.path}: there are no lanelets", "give a map as network, or the lanes")
        if self._has_right_of_way:  # which are read along the ego's way
            return None
        try:
            return find_straight_lanes(self.path, self.lanelets)
        except UsageError:
            return None


@dataclass(frozen=True)
class Obstacle:
    """Obstacle over time, in the plane.

    Attributes:
        name: Its id.
        length: [m].
        width: [m].
        steps: (K,) steps at which it is known; empty: it stands there all the time.
        states: (4, K), or (4, 1): x, y [m], heading [rad], speed [m/s].
    """

    name: str
    length: float
    width: float
    steps: NDArray[np.int64]
    states: Floats

    def track(self, first: int, samples: int, angle: float, line: ReferenceLine | None) -> VehicleTrack:
        """Return it from step ``first`` on, in the frame of a line, or turned by ``-angle``."""
        present, states = np.zeros(samples, dtype=bool), np.full((len(FIELDS), samples), np.nan)
        x, y = rotate(self.states[:2].T, angle).T
        if line is None:
            turned = np.array([math.remainder(h - angle, 2.0 * math.pi) for h in self.states[2]])
        else:
            x, y = line.to_road(x, y)
            turned = np.remainder(self.states[2] - line.heading(x) + math.pi, 2.0 * math.pi) - math.pi
        on_road = np.isfinite(x) & ((np.abs(y) <= ASIDE) | (line is None))
        rows = np.stack([x, y, turned, self.states[3]])
        if not len(self.steps):
            present[:] = on_road[0]
            states[:4], states[4] = rows[:, [0]], 0.0
        else:
            at = self.steps - first
            rows_inside = on_road & (at >= 0) & (at < samples)
            present[at[rows_inside]] = True
            states[:4, at[rows_inside]] = rows[:, rows_inside]
        return VehicleTrack(self.name, self.length, self.width, present, states)
