"""Descriptions of noise: which vehicle was missed and when, wrong positions and speeds, raw channels.

Every observation is compared with the neutral one, which the perception model makes of the same world from
zero noise. Zeros mean rank one half, so a vehicle that is detected less than half of the time is missed in
the neutral observation, and detecting it is a disturbance too. Errors are observation minus truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.base import batch
from avrare.driving import Observation, World
from avrare.protocols import Bools, Floats
from avrare.rollout.problem import Problem
from avrare.rollout.replay import replay_tape
from avrare.scenario.draws import Draws
from avrare.stack.closed_loop import ClosedLoop, LoopState

_MAX_DISTURBANCES = 8
_NEUTRAL_FACTOR = 3.0
"""Errors are reported above this multiple of the largest neutral error."""
_MIN_ERRORS = (0.1, 0.1, 0.3)
"""Smallest reported errors along and across the road [m] and of the speed [m/s]."""
_USUAL_DRAW = 0.5
"""Normal score above which a drawn option is reported."""
_DIRECTIONS = (
    ("m too far ahead", "m too far behind"),
    ("m too far left", "m too far right"),
    ("m/s too fast", "m/s too slow"),
)


@dataclass(frozen=True)
class Disturbance:
    """One disturbance of a rollout."""

    vehicle: str  # name; empty for raw channels
    text: str  # for example ``missed from t = 2.1 to 2.4 s``
    step: int  # the first one
    magnitude: float  # importance, by which a long list is shortened


def describe(problem: Problem, tape: Floats) -> str:
    """Describe noise (steps + 1, noise_size) in one sentence; zero noise by the vehicles missed with it."""
    return join_disturbances(find_disturbances(problem, tape))


def find_disturbances(problem: Problem, tape: Floats) -> list[Disturbance]:
    """Return the disturbances of a rollout in order of time."""
    loop, scene = problem.system, problem.scene
    if not isinstance(loop, ClosedLoop) or loop.perception is None or scene is None:
        return _describe_channels(tape)
    states = [
        state
        for state in replay_tape(problem.subset(problem.names[:1]), tape).states
        if isinstance(state, LoopState) and state.observation is not None
    ]
    if not states:
        return _describe_channels(tape)
    worlds = batch.concatenate([state.world for state in states])
    actual = batch.concatenate([state.observation for state in states if state.observation is not None])
    zeros = np.zeros((len(states), loop.perception.noise_size))
    neutral = loop.perception.observe(worlds, zeros)
    names = [f"car {name}" if name.isdecimal() else name for name in scene.names]
    names += [f"ghost {k}" for k in range(1, actual.detected.shape[1] - len(names) + 1)]
    dt = loop.simulator.dt
    found = _find_detections(actual.detected, neutral.detected, names, dt, bool(tape.any()))
    found += _find_errors(_compute_errors(worlds, actual), _compute_errors(worlds, neutral), names, dt)
    first, last = loop.world_noise - loop.simulator.noise_size, loop.world_noise
    found += _describe_channels(tape[:, first:last] if found or first else tape)
    if loop.start is not None and states[0].drawn is not None:
        found += _describe_draws(loop.start.draws, states[0].drawn.values[0])
    return sorted(found, key=lambda one: one.step)


def join_disturbances(disturbances: Sequence[Disturbance]) -> str:
    """Join disturbances to one sentence; of a long list the smallest ones are only counted."""
    if not disturbances:
        return "nothing is disturbed"
    largest = sorted(disturbances, key=lambda one: -one.magnitude)[:_MAX_DISTURBANCES]
    largest.sort(key=lambda one: one.step)
    phrases, previous = [], ""
    for one in largest:
        phrases.append(one.text if one.vehicle == previous else f"{one.vehicle} {one.text}".strip())
        previous = one.vehicle
    rest = len(disturbances) - len(largest)
    return ", then ".join(phrases) + (f", and {rest} smaller ones" if rest else "")


def _compute_errors(worlds: World, observation: Observation) -> Floats:
    # (3, T, V) of the positions and the speed; NaN where missed
    others = worlds.others
    x, y, speed_x = (
        part[:, : others.x.shape[1]] for part in (observation.x, observation.y, observation.speed_x)
    )
    speed = others.speed * np.cos(others.heading)
    return np.stack([x - others.x, y - others.y, speed_x - speed])


def _find_detections(
    detected: Bools, neutral: Bools, names: Sequence[str], dt: float, noisy: bool
) -> list[Disturbance]:
    # Detections (T, V) that differ from the neutral ones; for zero noise, all misses.
    kinds = [(~detected & neutral, "missed"), (detected & ~neutral, "detected (missed without noise)")]
    return [
        Disturbance(names[v], f"{verb} {_format_interval(first, last, dt)}", first, 1.0 + last - first)
        for mask, verb in (kinds if noisy else [(~detected, "missed")])
        for v in range(mask.shape[1])
        for first, last in _find_stretches(mask[:, v])
    ]


def _find_errors(actual: Floats, neutral: Floats, names: Sequence[str], dt: float) -> list[Disturbance]:
    found = []
    for axis, (least, directions) in enumerate(zip(_MIN_ERRORS, _DIRECTIONS, strict=True)):
        usual = np.nan_to_num(np.abs(neutral[axis]), nan=0.0).max(axis=0, initial=0.0)
        limits = np.maximum(_NEUTRAL_FACTOR * usual, least)
        disturbed = actual[axis] != neutral[axis]
        error = np.where(disturbed, np.nan_to_num(actual[axis], nan=0.0), 0.0)
        for v, sign in np.ndindex(error.shape[1], 2):
            signed = error[:, v] if sign == 0 else -error[:, v]
            for first, last in _find_stretches(signed > limits[v]):
                peak = float(signed[first - 1 : last].max())
                text = f"{peak:.2g} {directions[sign]} {_format_interval(first, last, dt)}"
                found.append(Disturbance(names[v], text, first, peak / limits[v]))
    return found


def _describe_draws(draws: Draws, values: Floats) -> list[Disturbance]:
    # By the normal score of the value itself, which is that of the tape only where nothing is correlated.
    found = []
    for name, law, value in zip(draws.names, draws.laws, values.tolist(), strict=True):
        score = float(law.score(value))
        if abs(score) > _USUAL_DRAW:
            found.append(Disturbance(name, f"is {value:.4g} ({score:+.2g} sigma)", 0, abs(score)))
    return found


def _find_stretches(mask: Bools) -> list[tuple[int, int]]:
    # First and last step of each stretch in which the mask (T,) of steps 1..T holds.
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(begin) + 1, int(end)) for begin, end in edges.reshape(-1, 2)]


def _format_interval(first: int, last: int, dt: float) -> str:
    digits = max(1, int(np.ceil(-np.log10(dt) - 1e-9))) if dt < 1.0 else 1
    times = [f"{step * dt:.{digits}f}" for step in (first, last)]
    return f"at t = {times[0]} s" if first == last else f"from t = {times[0]} to {times[1]} s"


def _describe_channels(tape: Floats) -> list[Disturbance]:
    # Each stretch of noise of each channel by its largest number.
    found = []
    for channel in range(tape.shape[1]):
        for begin, end in _find_stretches(tape[:, channel] != 0.0):
            first, last = begin - 1, end - 1  # row 0 is the noise of the initial state
            part = tape[first : last + 1, channel]
            peak = float(part[np.argmax(np.abs(part))])
            steps = f"step {first}" if first == last else f"steps {first}-{last}"
            text = f"channel {channel} at {steps}: {peak:+.2g} sigma"
            found.append(Disturbance("", text, first, float(np.linalg.norm(part))))
    return sorted(found, key=lambda one: one.step)
