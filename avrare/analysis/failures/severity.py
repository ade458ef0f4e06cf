"""Severity of a failing drive, and the ego's part in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from avrare.analysis.failures.avoidance import FULL_BRAKING, Approach
from avrare.analysis.monitor.monitoring import MonitoringResult
from avrare.driving import Road, Scene, Vehicles
from avrare.driving.geometry import (
    Rectangle,
    ego_rectangle,
    find_contacts,
    interpolate,
    other_rectangles,
    signed_distance,
)
from avrare.driving.lanes import lane_overlap
from avrare.driving.values import to_plane
from avrare.protocols import Floats
from avrare.results.recordings import FIELDS


@dataclass(frozen=True)
class Impact:
    """First contact of the ego with a vehicle.

    Attributes:
        time: Time since the first sample [s].
        speed: Relative speed [m/s].
        overlap: Width of the ego's overlap with the vehicle [m].
        delta_v: Change of the ego's velocity if both move on together, with masses proportional to their
            areas [m/s].
        least_deceleration: Least constant deceleration from the first sample on that avoids it; inf: none
            does [m/s^2].
        last_time: Last time at which braking by 6 m/s^2 avoids it; None: never [s].
        role: What the ego does: "stands", "is hit from behind", "cuts in" or "drives into it".
    """

    time: float
    speed: float
    overlap: float
    delta_v: float
    least_deceleration: float
    last_time: float | None
    role: str


@dataclass(frozen=True)
class Severity:
    """Severity of a failing drive towards the vehicle that is hit, or else decides the failure.

    Attributes:
        vehicle: Its name.
        impact: Contact with it; None: there is none.
        drac: Greatest deceleration that avoids a crash into it ahead, until 1 s before an impact [m/s^2].
        braking: Greatest deceleration of the ego, until an impact [m/s^2].
        reach: Greatest reach of the ego into a lane of it while the rule is violated [m]; 0: into none.
        duration: Time for which the rule is violated [s].
    """

    vehicle: str
    impact: Impact | None
    drac: float
    braking: float
    reach: float
    duration: float

    def describe(self) -> str:
        """Describe the severity."""
        impact, braking = self.impact, f"it brakes by {self.braking:.1f} m/s2 at most"
        if impact is None:
            reach = f"{self.reach:.1f} m in a lane of {self.vehicle}, " if self.reach else ""
            return f"ego {reach}violates for {self.duration:.1f} s; {braking}; DRAC {self.drac:.1f} m/s2"
        avoided = "never" if impact.last_time is None else f"until t = {impact.last_time:.1f} s"
        return (
            f"ego {impact.role} ({self.vehicle}) at t = {impact.time:.1f} s: {impact.speed:.1f} m/s, "
            f"overlap {impact.overlap:.1f} m, delta-v {impact.delta_v:.1f} m/s; {braking}, "
            f"{FULL_BRAKING:g} m/s2 avoid it {avoided}, {impact.least_deceleration:.1f} m/s2 from the "
            f"start on; DRAC {self.drac:.1f} m/s2"
        )


def describe_severities(severities: Sequence[Severity]) -> str:
    """Describe the median severities of some failures; empty without failures."""
    if not severities:
        return ""
    drac, braking, duration = (
        _median(getattr(severity, name) for severity in severities)
        for name in ("drac", "braking", "duration")
    )
    common = f"braking {braking:.1f} m/s2, DRAC {drac:.1f} m/s2"
    impacts = [severity.impact for severity in severities if severity.impact is not None]
    if 2 * len(impacts) > len(severities):
        roles = Counter(impact.role for impact in impacts)
        parts = ", ".join(f"{_percent(n / len(impacts))} ego {role}" for role, n in roles.most_common())
        parts = f"ego {next(iter(roles))}" if len(roles) == 1 else parts
        speed, overlap = (
            _median(getattr(impact, name) for impact in impacts) for name in ("speed", "overlap")
        )
        avoidable = sum(impact.last_time is not None for impact in impacts) / len(impacts)
        return (
            f"{parts}: {speed:.1f} m/s, overlap {overlap:.1f} m, {common}; "
            f"{FULL_BRAKING:g} m/s2 in time would have avoided "
            f"{'all' if avoidable == 1.0 else 'none' if not avoidable else _percent(avoidable)} of them"
        )
    text = f"violated for {duration:.1f} s, {common}"
    reaches = [severity.reach for severity in severities if severity.reach > 0.0]
    if not reaches:
        return text
    small_reach = 0.3  # reach into a lane below which the ego only touches it [m]
    small = sum(reach < small_reach for reach in reaches) / len(reaches)
    touching = f"{_percent(small)} by less than {small_reach:g} m, " if small else ""
    return f"ego reaches into the lane, {touching}median {_median(reaches):.1f} m; {text}"


def _median(values: Iterable[float]) -> float:
    return float(np.median(list(values)))


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def measure_severity(result: MonitoringResult) -> Severity | None:
    """Return the severity of a drive; None where the rule is kept, or without vehicles on lanes."""
    recording, scene = result.recording, result.recording.scene
    if scene is None or not scene.names or not scene.road.lane_centres or not result.violated:
        return None
    signals = recording.signals
    ego, others = (Vehicles(*(signals[f"{who}_{name}"] for name in FIELDS)) for who in ("ego", "others"))
    distance = signed_distance(ego_rectangle(ego, scene), other_rectangles(others, scene))
    touching = np.flatnonzero((distance <= 0.0).any(axis=1))
    end = int(touching[0]) if touching.size else recording.samples - 1
    number = int(np.argmin(distance[end])) if touching.size else _find_vehicle(result, distance)
    pair = _Pair(
        recording.dt,
        scene.road,
        _Car(ego, scene.ego_length, scene.ego_width),
        _Car(_select(others, number), float(scene.lengths[number]), float(scene.widths[number])),
    )
    violated = result.prefix_violated if result.body is None else result.body <= 0.0
    reach = np.where(pair.other.find_reach(scene.road) > 0.0, pair.ego.find_reach(scene.road), 0.0)
    # DRAC grows without bound in the last second
    last = end - (round(1.0 / recording.dt) if touching.size else 0)
    return Severity(
        scene.names[number],
        _measure_impact(pair, scene, number, end) if touching.size else None,
        float(pair.compute_drac()[: max(last, 0) + 1].max()),
        float(np.maximum(-ego.acceleration[: end + 1], 0.0).max()),
        float(reach[:, violated].max(initial=0.0).clip(0.0, scene.ego_width)),
        float(violated.sum() * recording.dt),
    )


def _find_vehicle(result: MonitoringResult, distance: Floats) -> int:
    names, decisive = result.recording.names, result.first or result.worst
    if decisive is None:
        return int(np.argmin(distance.min(axis=0)))
    vehicle_names = [name for name in decisive.vehicles.values() if name in names]
    return names.index(vehicle_names[0]) if vehicle_names else int(np.argmin(distance[decisive.sample]))


def _select(vehicles: Vehicles, index: int | slice | list[int]) -> Vehicles:
    return Vehicles(*(values[..., index] for values in vars(vehicles).values()))


@dataclass(frozen=True)
class _Car:
    """Motion (T,) of one vehicle, and its size [m]."""

    motion: Vehicles
    length: float
    width: float

    @property
    def extents(self) -> tuple[Floats, Floats]:
        """Half its extents along and across the road, (T,)."""
        cos, sin = np.abs(np.cos(self.motion.heading)), np.abs(np.sin(self.motion.heading))
        return 0.5 * (self.length * cos + self.width * sin), 0.5 * (self.length * sin + self.width * cos)

    def find_reach(self, road: Road) -> Floats:
        """Return (L, T) how far it reaches into each lane."""
        return lane_overlap(road, self.motion.x, self.motion.y, *self.extents)


@dataclass(frozen=True)
class _Pair:
    """The ego and one other vehicle over time."""

    dt: float
    road: Road
    ego: _Car
    other: _Car

    def compute_drac(self) -> Floats:
        """Return (T,) the deceleration that avoids a crash into the other ahead at constant speed."""
        cars = self.ego.motion, self.other.motion
        along, across = (sum(sides) for sides in zip(self.ego.extents, self.other.extents, strict=True))
        gap, aside = cars[1].x - cars[0].x - along, np.abs(cars[1].y - cars[0].y)
        ego, other = (car.speed * np.cos(car.heading) for car in cars)
        closing = np.where((gap > 0.0) & (aside < across), np.maximum(ego - other, 0.0), 0.0)
        return np.asarray(closing**2 / (2.0 * np.maximum(gap, 1e-3)))

    def cuts_in(self, end: int) -> bool:
        """Return whether the ego has come into a lane of the other shortly before sample ``end``."""
        # a change of lane in the last 3 s is a cut-in
        recent = slice(max(end - round(3.0 / self.dt), 0), end + 1)
        ego, other = (car.find_reach(self.road)[:, recent] for car in (self.ego, self.other))
        shared = (ego[:, -1] > 0.0) & (other > 0.0).all(axis=1)
        return bool(shared.any() and (ego[shared].min(axis=1) <= 0.0).all())


def _measure_impact(pair: _Pair, scene: Scene, number: int, end: int) -> Impact:
    ego, other, begin = pair.ego, pair.other, max(end - 1, 0)
    alone = replace(scene, lengths=scene.lengths[[number]], widths=scene.widths[[number]])
    samples = ((_select(ego.motion, [k]), _column(_select(other.motion, [k]))) for k in (begin, end))
    share = np.minimum(find_contacts(alone, *samples)[0], 1.0)
    poses = [
        to_plane(scene.road, interpolate(_select(car.motion, [begin]), _select(car.motion, [end]), share))
        for car in (ego, other)
    ]
    ways = [to_plane(scene.road, _select(car.motion, slice(0, end + 1))) for car in (ego, other)]
    sizes = (ego.length, ego.width), (other.length, other.width)
    approach = Approach(pair.dt, ways[0], ways[1], sizes)
    speeds = [pose.speed[0] * np.exp(1j * pose.heading[0]) for pose in poses]
    speed, mass = float(abs(speeds[0] - speeds[1])), other.length * other.width
    ahead, overlap = _locate(ego, other, *poses)
    return Impact(
        float((begin + share[0]) * pair.dt) if end else 0.0,
        speed,
        overlap,
        speed * mass / (mass + ego.length * ego.width),
        approach.find_least_deceleration(),
        approach.find_last_time(),
        _name_role(pair, end, float(poses[0].speed[0]), ahead),
    )


def _column(vehicles: Vehicles) -> Vehicles:
    return Vehicles(*(values[:, None] for values in vars(vehicles).values()))


def _locate(ego: _Car, other: _Car, pose: Vehicles, place: Vehicles) -> tuple[float, float]:
    """Return how far the other's centre is ahead of the ego's, and the width of the ego that it meets."""
    box = Rectangle(place.x, place.y, place.heading, np.asarray(other.length), np.asarray(other.width))
    corners = box.corners()
    cos, sin = np.cos(pose.heading[0]), np.sin(pose.heading[0])
    aside = cos * (corners[1] - pose.y[0]) - sin * (corners[0] - pose.x[0])
    overlap = min(aside.max(), 0.5 * ego.width) - max(aside.min(), -0.5 * ego.width)
    ahead = cos * (place.x[0] - pose.x[0]) + sin * (place.y[0] - pose.y[0])
    return float(ahead), float(max(overlap, 0.0))


def _name_role(pair: _Pair, end: int, speed: float, ahead: float) -> str:
    if speed < 0.3:  # it stands [m/s]
        return "stands"
    # share of the lengths of both that lies between the centres at a contact with the ego's rear
    rear_share = 0.7
    if ahead < -0.5 * rear_share * (pair.ego.length + pair.other.length):
        return "is hit from behind"
    if ahead < 0.5 * pair.ego.length and pair.cuts_in(end):
        return "cuts in"
    return "drives into it"
