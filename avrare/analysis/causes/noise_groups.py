"""Groups of noise numbers: the start, components, kinds of error, vehicles, channels and time windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.noise_words import format_range
from avrare.rollout.problem import Problem
from avrare.stack.closed_loop import ClosedLoop
from avrare.stack.part_checks import find_noise_names, find_perfect_noise


@dataclass(frozen=True)
class NoiseGroup:
    """Numbers of a tape that are looked at together.

    Attributes:
        name: Description.
        sort: "component", "start", "error", "vehicle", "channel" or "time".
        mask: (steps + 1, noise_size) which numbers.
    """

    name: str
    sort: str
    mask: Bools


def list_groups(problem: Problem, windows: int = 6, channels: bool = False) -> list[NoiseGroup]:
    """List the groups of a problem's noise, without any that is all of it or twice the same.

    Args:
        problem: Problem with named noise, or not.
        windows: Number of time windows of equal length; 0: none.
        channels: Give each channel a row of its own, if there are not too many.
    """
    names, shape = find_noise_names(problem.system), (problem.steps + 1, problem.noise_size)
    single = _single(names) if channels or len(names) <= 4 else []
    candidates = [
        NoiseGroup(name, sort, np.broadcast_to(_of(names, members), shape))
        for name, sort, members in (
            *_components(problem, names),
            *_parts(names[count_draws(problem) :]),
            *single,
        )
    ]
    start = find_start(problem)
    if start is not None and count_draws(problem):
        candidates = [start, *candidates]
    candidates += _windows(problem, windows)
    candidates += [start] if start is not None else []
    groups: list[NoiseGroup] = []
    for group in candidates:
        covers_all = group.mask.all() and (group.sort != "component" or group.name == "simulator")
        if not covers_all and not any(np.array_equal(group.mask, other.mask) for other in groups):
            groups.append(group)
    return groups


def _of(names: Sequence[str], members: Sequence[str]) -> Bools:
    return np.array([name in members for name in names], dtype=bool)


def _components(problem: Problem, names: Sequence[str]) -> list[tuple[str, str, Sequence[str]]]:
    loop = problem.system
    if not isinstance(loop, ClosedLoop):
        return []
    drawn, world = count_draws(problem), loop.world_noise
    rows = []
    for part, members in (("simulator", names[drawn:world]), ("perception", names[world:])):
        has_name = len(members) == 1 and members[0] != f"{part} noise 0"
        rows += [(members[0] if has_name else part, "component", members)] * bool(members)
    return rows


def find_start(problem: Problem) -> NoiseGroup | None:
    """Return the noise of the initial state alone; None if there is none, or no other noise."""
    loop, drawn = problem.system, count_draws(problem)
    mask = np.zeros((problem.steps + 1, problem.noise_size), dtype=bool)
    mask[0, : loop.world_noise if isinstance(loop, ClosedLoop) else None] = True
    mask[:, :drawn] = True
    return NoiseGroup("start", "start", mask) if mask.any() and not mask.all() else None


def _parts(names: Sequence[str]) -> list[tuple[str, str, Sequence[str]]]:
    # "lateral error of cut_in": a kind of error, and a vehicle
    split = {name: name.rsplit(" of ", 1) for name in names if " of " in name}
    if len(split) < len(names):
        return []
    kinds = dict.fromkeys(kind for kind, _ in split.values())
    vehicles = dict.fromkeys(vehicle for _, vehicle in split.values())
    rows: list[tuple[str, str, Sequence[str]]] = [
        (kind, "error", [name for name, parts in split.items() if parts[0] == kind]) for kind in kinds
    ]
    return rows + [
        (f"all noise of {vehicle}", "vehicle", [name for name, parts in split.items() if parts[1] == vehicle])
        for vehicle in vehicles
    ]


def _single(names: Sequence[str]) -> list[tuple[str, str, Sequence[str]]]:
    # of more channels, only named ones get rows
    return [(name, "channel", [name]) for name in names] if len(names) <= 24 else []


def _windows(problem: Problem, windows: int) -> list[NoiseGroup]:
    shape, dt = (problem.steps + 1, problem.noise_size), problem.dt
    groups = []
    for rows in np.array_split(np.arange(shape[0]), min(windows, shape[0])) if windows else []:
        mask = np.zeros(shape, dtype=bool)
        mask[rows] = True
        begin, end = int(rows[0]), int(rows[-1])
        groups.append(NoiseGroup(format_range(begin, end, dt), "time", mask))
    return groups


def count_draws(problem: Problem) -> int:
    """Return how many numbers draw options of the scene; they come first in a tape."""
    loop = problem.system
    return loop.world_noise - loop.simulator.noise_size if isinstance(loop, ClosedLoop) else 0


def _is_draw(problem: Problem) -> Bools:
    return np.arange(problem.noise_size) < count_draws(problem)


def make_perfect(problem: Problem, tapes: Floats, mask: Bools) -> Floats:
    """Return tapes (N, steps + 1, noise_size) whose numbers in ``mask`` are those of a perfect part.

    Drawn options are not errors: they stay.
    """
    return np.where(mask & ~_is_draw(problem), find_perfect_noise(problem.system), tapes)


def clip_outliers(problem: Problem, tapes: Floats, limit: float) -> Floats:
    """Return tapes without numbers beyond ``limit``, except for draws and those that decide detections."""
    errors = (find_perfect_noise(problem.system) == 0.0) & ~_is_draw(problem)
    return np.where(errors, np.clip(tapes, -limit, limit), tapes)
