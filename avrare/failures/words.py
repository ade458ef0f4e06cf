"""What a disturbance is, in words: who was missed and when, who was seen in the wrong place, which noise.

Every observation is compared with the neutral one: what the perception model makes of the same world from
noise of zeros. Zeros mean rank one half, so a vehicle that is seen less than half of the time is missed in
the neutral observation, and seeing it is a disturbance too. Errors are observation minus truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare import batch
from avrare.build.closed_loop import LoopState
from avrare.build.scenario import BuildableScenario
from avrare.failures.driving import drive
from avrare.protocols import Bools, Floats

MOST_PHRASES = 8
_TIMES_NEUTRAL = 3.0
"""An error is told where it is larger than this many times the largest neutral one."""
_FLOOR = (0.1, 0.1, 0.3)
"""Errors along and across the road [m] and of the speed [m/s] that are never told."""
_DIRECTIONS = (
    ("m too far ahead", "m too far behind"),
    ("m too far left", "m too far right"),
    ("m/s too fast", "m/s too slow"),
)


@dataclass(frozen=True)
class Phrase:
    """One thing that was disturbed.

    Attributes:
        who: The vehicle; empty where there is none.
        text: For example ``missed from t = 2.1 to 2.4 s``.
        step: Where it begins.
        size: How much it matters, to leave the least out of a long list.
    """

    who: str
    text: str
    step: int
    size: float


@dataclass(frozen=True)
class _Seen:
    """Observations after step 0: detected (T, V), errors (3, T, V), NaN where missed."""

    detected: Bools
    errors: Floats


def describe(scenario: BuildableScenario, tape: Floats) -> str:
    """One sentence on the noise (steps + 1, noise_size) of a rollout.

    Noise of zeros is described by who is missed with it.
    """
    return sentence(phrases(scenario, tape))


def phrases(scenario: BuildableScenario, tape: Floats) -> list[Phrase]:
    """The same as single phrases, in the order of time."""
    loop = scenario.stack.loop
    states = [
        state
        for state in drive(scenario.problem(scenario.specifications[0]), tape).states
        if isinstance(state, LoopState) and state.observation is not None
    ]
    if loop.perception is None or scenario.scene is None or not states:
        return _channels(tape)
    worlds = batch.concatenate([state.world for state in states])
    now = _seen(worlds, batch.concatenate([state.observation for state in states]))
    zeros = np.zeros((len(states), loop.perception.noise_size))
    neutral = _seen(worlds, loop.perception.observe(worlds, zeros))
    names, dt, own = scenario.scene.names, loop.simulator.dt, loop.simulator.noise_size
    found = _missed(now, neutral, names, dt, bool(tape.any())) + _errors(now, neutral, names, dt)
    found += _channels(tape[:, :own] if found else tape)
    return sorted(found, key=lambda phrase: phrase.step)


def sentence(found: Sequence[Phrase]) -> str:
    """Phrases one after another; of too many the smallest are counted only."""
    if not found:
        return "nothing is disturbed"
    kept = sorted(found, key=lambda phrase: -phrase.size)[:MOST_PHRASES]
    kept.sort(key=lambda phrase: phrase.step)
    words, before = [], ""
    for phrase in kept:
        words.append(phrase.text if phrase.who == before else f"{phrase.who} {phrase.text}".strip())
        before = phrase.who
    rest = len(found) - len(kept)
    return ", then ".join(words) + (f", and {rest} smaller ones" if rest else "")


def _seen(worlds: Any, observation: Any) -> _Seen:
    others = worlds.others
    speed = others.speed * np.cos(others.heading)
    errors = [observation.x - others.x, observation.y - others.y, observation.speed_x - speed]
    return _Seen(observation.detected, np.stack(errors))


def _missed(now: _Seen, neutral: _Seen, names: Sequence[str], dt: float, relative: bool) -> list[Phrase]:
    """Who is missed, and who is seen, other than in the neutral observations; or who is missed at all."""
    seen, usual = now.detected, neutral.detected
    kinds = [(~seen & usual, "missed"), (seen & ~usual, "seen, missed without noise,")]
    return [
        Phrase(_name(names[v]), f"{word} {_when(first, last, dt)}", first, 1.0 + last - first)
        for mask, word in (kinds if relative else [(~seen, "missed")])
        for v in range(mask.shape[1])
        for first, last in _runs(mask[:, v])
    ]


def _errors(now: _Seen, neutral: _Seen, names: Sequence[str], dt: float) -> list[Phrase]:
    found = []
    for axis, (floor, directions) in enumerate(zip(_FLOOR, _DIRECTIONS, strict=True)):
        usual = np.nan_to_num(np.abs(neutral.errors[axis]), nan=0.0).max(axis=0, initial=0.0)
        least = np.maximum(_TIMES_NEUTRAL * usual, floor)
        disturbed = now.errors[axis] != neutral.errors[axis]
        error = np.where(disturbed, np.nan_to_num(now.errors[axis], nan=0.0), 0.0)
        for v, sign in np.ndindex(error.shape[1], 2):
            signed = error[:, v] if sign == 0 else -error[:, v]
            for first, last in _runs(signed > least[v]):
                peak = float(signed[first - 1 : last].max())
                text = f"{peak:.2g} {directions[sign]} {_when(first, last, dt)}"
                found.append(Phrase(_name(names[v]), text, first, peak / least[v]))
    return found


def _runs(mask: Bools) -> list[tuple[int, int]]:
    """First and last step of each stretch in which the mask (T,) of steps 1..T holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(begin) + 1, int(end)) for begin, end in edges.reshape(-1, 2)]


def _when(first: int, last: int, dt: float) -> str:
    digits = max(1, int(np.ceil(-np.log10(dt) - 1e-9))) if dt < 1.0 else 1
    times = [f"{step * dt:.{digits}f}" for step in (first, last)]
    return f"at t = {times[0]} s" if first == last else f"from t = {times[0]} to {times[1]} s"


def _name(name: str) -> str:
    return f"car {name}" if name.isdecimal() else name


def _channels(tape: Floats) -> list[Phrase]:
    """Stretches of noise in each channel, with the largest number of each."""
    found = []
    for channel in range(tape.shape[1]):
        for begin, end in _runs(tape[:, channel] != 0.0):
            first, last = begin - 1, end - 1  # steps count from 0 here: row 0 is the noise of the start
            part = tape[first : last + 1, channel]
            peak = float(part[np.argmax(np.abs(part))])
            where = f"step {first}" if first == last else f"steps {first}-{last}"
            text = f"channel {channel} at {where}: {peak:+.2g} sigma"
            found.append(Phrase("", text, first, float(np.linalg.norm(part))))
    return sorted(found, key=lambda phrase: phrase.step)
