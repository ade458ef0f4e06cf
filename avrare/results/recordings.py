"""Recordings: recorded drives as arrays over time, with the signals that a simulator would provide."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError, did_you_mean
from avrare.driving import Road, Scene, Vehicles, World
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
from avrare.estimation.result.result import Failures
from avrare.protocols import Bools, Floats
from avrare.results.run import Run
from avrare.results.stored_failures import select_failure
from avrare.rollout.problem import Problem
from avrare.rollout.replay import ReplayedRollout, replay_tape
from avrare.scenario.schema import Block

FIELDS = ("x", "y", "heading", "speed", "acceleration")

ABSENT = {"x": -1e6, "y": -1e6, "heading": 0.0, "speed": 0.0, "acceleration": 0.0}
"""State of an absent vehicle: standing far behind and far to the right, in no lane.

No predicate about distances, neighbours or closing speeds holds for it, so no rule applies to it. Unlike NaN
or infinity it gives every predicate a number.
"""


@dataclass(frozen=True)
class Recording:
    """One recorded drive, or any other signals over time.

    Attributes:
        source: Origin, for messages.
        dt: Step [s].
        start: Time of sample 0 [s].
        signals: Maps each name to its values (T, ...); with vehicles, the names of a driving simulator.
        scene: Road, sizes and names; None without vehicles or road.
        names: Names of the other vehicles.
    """

    source: str
    dt: float
    start: float
    signals: Mapping[str, NDArray[Any]]
    scene: Scene | None = None
    names: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """Number of samples T."""
        return len(next(iter(self.signals.values())))

    @property
    def times(self) -> Floats:
        """Times of the samples (T,) [s]."""
        return np.asarray(self.start + self.dt * np.arange(self.samples))

    def time(self, sample: int) -> float:
        """Return the time of a sample [s]."""
        return self.start + self.dt * sample

    def world(self, sample: int) -> World:
        """Return the vehicles at a sample, as one particle."""
        rows = slice(sample, sample + 1)
        ego, others = (
            Vehicles(*(self.signals[f"{who}_{field}"][rows] for field in FIELDS)) for who in ("ego", "others")
        )
        return World(np.array([sample]), ego, others, np.zeros(1))


@dataclass(frozen=True)
class VehicleTrack:
    """One vehicle, a rectangle of ``length`` and ``width`` [m], over time.

    Attributes:
        present: (T,) False where it was not recorded; the states there are ignored.
        states: (5, T): x, y [m], heading [rad], speed [m/s], acceleration [m/s^2]. An acceleration of NaN is
            replaced by the change of speed since the sample before.
    """

    name: str
    length: float
    width: float
    present: Bools
    states: Floats

    def fill_gaps(self, dt: float) -> dict[str, Floats]:
        """Return the states by name (T,), those of an absent vehicle where it was not recorded."""
        values = dict(zip(FIELDS, self.states, strict=True))
        change = np.zeros(len(self.present))
        both = self.present[1:] & self.present[:-1]
        change[1:][both] = np.diff(values["speed"])[both] / dt
        recorded = values["acceleration"]
        values["acceleration"] = np.where(np.isnan(recorded), change, recorded)
        return {field: np.where(self.present, x, ABSENT[field]) for field, x in values.items()}


def assemble_recording(
    source: str, dt: float, start: float, ego: VehicleTrack, others: Sequence[VehicleTrack], road: Road | None
) -> Recording:
    """Return the recording of the ego, present at every sample, and other vehicles.

    Without a road there are signals but no scene, and rules cannot be monitored.
    """
    # names with a meaning in formulas, which no other vehicle may have
    reserved = {"ego": "the ego", "others": "all vehicles but the ego"}
    for name in (other.name for other in others if other.name in reserved):
        raise UsageError(
            f"{source}: a vehicle other than the ego is called {name!r}",
            f"in formulas that means {reserved[name]}: rename the vehicle",
        )
    signals = {f"ego_{field}": x for field, x in ego.fill_gaps(dt).items()}
    filled = [other.fill_gaps(dt) for other in others]
    for field in FIELDS:
        rows = np.array([values[field] for values in filled], dtype=np.float64)
        signals[f"others_{field}"] = rows.reshape(len(others), len(ego.present)).T.copy()
    lengths, widths = (np.array([getattr(other, key) for other in others]) for key in ("length", "width"))
    names = tuple(other.name for other in others)
    scene = None
    if road is not None:
        speeds = (other.states[3][other.present] for other in others)
        # any faster sample [m/s]: it is not parked
        moving = np.array([bool(np.any(np.abs(speed) > 0.01)) for speed in speeds], dtype=bool)
        scene = Scene(dt, road, ego.length, ego.width, names, lengths, widths, moving)
        _require_lanes(source, signals, scene)
        _show_contacts(signals, scene)
    signals |= _compute_distances(signals, ego, lengths, widths, road)
    return Recording(source, dt, start, signals, scene, names)


def _show_contacts(signals: dict[str, Floats], scene: Scene) -> None:
    # Vehicles that pass through the ego between two samples are at the second one where they touch it first.
    ego, others = (Vehicles(*(signals[f"{who}_{field}"] for field in FIELDS)) for who in ("ego", "others"))
    before, after = ((_at(ego, rows), _at(others, rows)) for rows in (slice(None, -1), slice(1, None)))
    contacts = find_contacts(scene, before, after)
    apart = signed_distance(ego_rectangle(ego, scene), other_rectangles(others, scene)) > 0.0
    hidden = np.isfinite(contacts) & apart[:-1] & apart[1:]
    for sample, vehicle in np.argwhere(hidden).tolist():
        share = contacts[sample, vehicle]
        ego_then, other_then = (
            interpolate(_at(earlier, place), _at(later, place), share)
            for earlier, later, place in (
                (before[0], after[0], sample),
                (before[1], after[1], (sample, vehicle)),
            )
        )
        for field in FIELDS:
            signals[f"ego_{field}"][sample + 1] = getattr(ego_then, field)
            signals[f"others_{field}"][sample + 1, vehicle] = getattr(other_then, field)


def _at(vehicles: Vehicles, place: Any) -> Vehicles:
    return Vehicles(*(values[place] for values in vars(vehicles).values()))


def _require_lanes(source: str, signals: Mapping[str, Floats], scene: Scene) -> None:
    # Where nobody is in a lane, no rule can be broken: a verdict would say nothing.
    hint = "the lanes and the vehicles are in different coordinates, or the lanes are those of another road"
    if not _is_in_lane(scene.road, signals, "ego", scene.ego_length, scene.ego_width).any():
        raise UsageError(f"{source}: the ego is in no lane at any time", hint)
    if scene.road.lanes or not scene.moving.any():  # of a network along the ego's own way
        return
    inside = _is_in_lane(scene.road, signals, "others", scene.lengths, scene.widths).any(axis=0)
    if not inside[scene.moving].any():
        raise UsageError(f"{source}: no moving vehicle but the ego is ever in a lane", hint)


def _is_in_lane(
    road: Road, signals: Mapping[str, Floats], who: str, length: Floats | float, width: Floats | float
) -> Any:
    x, y = signals[f"{who}_x"], signals[f"{who}_y"]
    half_length, half_width = (np.broadcast_to(0.5 * np.asarray(size), x.shape) for size in (length, width))
    return np.asarray(lane_overlap(road, x, y, half_length, half_width) > 0.0).any(axis=0)


def _compute_distances(
    signals: Mapping[str, Floats], ego: VehicleTrack, lengths: Floats, widths: Floats, road: Road | None
) -> dict[str, Floats]:
    # (T, V) to each other vehicle, and the least of them (T,)
    places = (Vehicles(*(signals[f"{who}_{field}"] for field in FIELDS)) for who in ("ego", "others"))
    ego_states, other_states = places if road is None else (to_plane(road, vehicles) for vehicles in places)
    ego_box = Rectangle(
        ego_states.x[:, None],
        ego_states.y[:, None],
        ego_states.heading[:, None],
        np.array(ego.length),
        np.array(ego.width),
    )
    other_boxes = Rectangle(other_states.x, other_states.y, other_states.heading, lengths, widths)
    distance = signed_distance(ego_box, other_boxes)
    return {"distance": distance, "gap": distance.min(axis=1, initial=np.inf)}


def parse_road(centres: str, width: float, ramp: str | None = None, broad: str | None = None) -> Road:
    """Return the road of ``--lanes -1.75,1.75,5.25 --lane-width 3.5 --access-ramp 0 --broad-marking 1``."""
    hint = "for example --lanes=-1.75,1.75,5.25 (y to the left, in metres)"
    try:
        lanes = tuple(float(word) for word in centres.split(","))
    except ValueError:
        text = f"--lanes should be numbers separated by commas, not {centres!r}"
        raise UsageError(text, hint) from None
    if not all(map(math.isfinite, lanes)) or list(lanes) != sorted(set(lanes)):
        raise UsageError(f"--lanes should go from right to left, not {centres!r}", hint)
    if not (math.isfinite(width) and width > 0.0):
        raise UsageError(f"--lane-width should be above zero, not {width:g}")
    lane_sets = []
    for option, value in (("--access-ramp", ramp), ("--broad-marking", broad)):
        words = [] if value is None else [word.strip() for word in value.split(",")]
        if not all(word.isdecimal() and int(word) < len(lanes) for word in words):
            raise UsageError(f"{option} should name lanes 0 to {len(lanes) - 1}, not {value!r}")
        lane_sets.append(tuple(map(int, words)))
    return Road(lanes, width, lane_sets[0], broad_markings=lane_sets[1])


@dataclass(frozen=True)
class ReplayedFailure:
    """A stored failure of a run, replayed; ``changes`` are messages about robustness that differs now."""

    specification: str
    index: int
    recording: Recording
    changes: tuple[str, ...]


def replay_run_failure(
    run: Run, specification: str | None, index: int | None, rule: str | None = None
) -> ReplayedFailure:
    """Replay a stored failure of a run; without an index the least robust one, which also checks all others.

    Its specification is given by name or by its option ``rule``, or only one has failures.
    """
    problem = run.scenario.problem(run.scenario.specifications)
    if specification is None:
        specification = _find_rule(run, rule)
    elif specification not in problem.names:
        hint = did_you_mean(specification, problem.names)
        raise UsageError(f"{run.folder}: unknown specification {specification!r}", hint)
    name, chosen = select_failure(run, specification, index)
    failures = run[name].failures
    count = len(failures.robustness)
    indices = range(count) if index is None else [index]
    changes = _compare_robustness(problem.subset([name]), failures, indices)
    source = f"{run.folder}: failure {chosen} of {count} stored of {name}"
    rollout = replay_tape(problem, failures.noise[chosen])
    if rollout.error is not None:
        raise UsageError(f"{source}: the rollout ends with an error: {rollout.error}")
    return ReplayedFailure(name, chosen, record_rollout(problem, rollout, source), changes)


def record_rollout(problem: Problem, rollout: ReplayedRollout, source: str) -> Recording:
    """Return the recording of a rollout, up to its error if there is one."""
    scene, dt = problem.scene, 1.0 if problem.dt is None else problem.dt
    return Recording(source, dt, 0.0, rollout.signals, scene, () if scene is None else scene.names)


def _find_rule(run: Run, rule: str | None) -> str | None:
    parts = () if rule is None or run.definition is None else run.definition.specifications.items()
    names = [name for name, part in parts if isinstance(part, Block) and part.resolved.get("rule") == rule]
    return names[0] if len(names) == 1 else None


def _compare_robustness(problem: Problem, failures: Failures, indices: Sequence[int]) -> tuple[str, ...]:
    messages = []
    for begin in range(0, len(indices), problem.chunk):
        chosen = list(indices[begin : begin + problem.chunk])
        robustness = problem.robustness(failures.noise[chosen])
        for k, now in zip(chosen, robustness, strict=True):
            if now != (before := failures.robustness[k]):
                place = f"failure {k} of {problem.names[0]}"
                messages.append(f"{place}: robustness {now:.9g} now, {before:.9g} when stored")
    return tuple(messages)
