"""Words for noise: what it does, how much and on which side, and when; the same for all who tell of it."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from avrare.protocols import Bools, Floats, Misreading
from avrare.rollout.problem import Problem
from avrare.rollout.replay import ReplayedRollout, replay_tape
from avrare.stack.closed_loop import ClosedLoop
from avrare.stack.noise_names import find_noise_names, find_perfect_noise

_NEUTRAL_FACTOR = 3.0
"""Errors are described above this multiple of the largest one without noise."""
_WINDOWS = 8
_MAX_WINDOWS = 3


def format_time(step: int, dt: float | None) -> str:
    """Return ``t = 1.9 s``, or ``step 19`` where steps take no time."""
    return f"step {step}" if dt is None else f"t = {step * dt:.{_count_digits(dt)}f} s"


def format_steps(steps: int, dt: float | None) -> str:
    """Return ``0.9 s``, or ``9 steps``."""
    return f"{steps} step{'s' * (steps != 1)}" if dt is None else f"{steps * dt:.{_count_digits(dt)}f} s"


def format_span(first: int, last: int, dt: float | None) -> str:
    """Return ``at t = 1.9 s``, or ``for 0.9 s from t = 1.9 s``."""
    if first == last:
        return f"at {format_time(first, dt)}"
    return f"for {format_steps(last - first + 1, dt)} from {format_time(first, dt)}"


def format_range(first: int, last: int, dt: float | None) -> str:
    """Return ``t = 1.9-2.7 s``, or ``steps 19-27``."""
    if dt is None:
        return f"steps {first}-{last}"
    return f"t = {first * dt:.{_count_digits(dt)}f}-{last * dt:.{_count_digits(dt)}f} s"


def _count_digits(dt: float) -> int:
    return max(1, math.ceil(-math.log10(dt) - 1e-9)) if dt < 1.0 else 1


@dataclass(frozen=True)
class Disturbance:
    """Disturbance of a rollout, or of most rollouts of a sample.

    Attributes:
        subject: What is disturbed.
        text: How much and when, such as ``missed for 0.3 s from t = 2.1 s``.
        step: Its first step.
        magnitude: Its importance, by which a long list is shortened.
    """

    subject: str
    text: str
    step: int
    magnitude: float


def join_disturbances(disturbances: Sequence[Disturbance]) -> str:
    """Join disturbances to one sentence; of a long list the smallest ones are only counted."""
    if not disturbances:
        return "nothing is disturbed"
    largest = sorted(disturbances, key=lambda each: -each.magnitude)[:8]
    largest = [each for each in largest if each.magnitude] or largest[:1]
    largest.sort(key=lambda each: each.step)
    phrases, previous = [], ""
    for each in largest:
        phrases.append(each.text if each.subject == previous else f"{each.subject} {each.text}")
        previous = each.subject
    rest = len(disturbances) - len(largest)
    more = f", and {rest} smaller ones" if rest > 1 else ", and a smaller one" if rest else ""
    return ", then ".join(phrases) + more


def describe_tape(problem: Problem, tape: Floats) -> str:
    """Describe noise (steps + 1, noise_size) in one sentence; zero noise by the vehicles missed with it."""
    rollout = replay_tape(problem.subset(problem.names[:1]), tape)
    return join_disturbances(find_disturbances(problem, tape, rollout))


def find_disturbances(problem: Problem, tape: Floats, rollout: ReplayedRollout) -> list[Disturbance]:
    """Return the disturbances of a rollout and its tape (steps + 1, noise_size) in order of time.

    Errors are described in their units where the system declares them, other noise in standard deviations.
    Zeros mean rank one half, so a vehicle that is detected less than half of the time is missed without
    noise, and detecting it is a disturbance too; for a tape of zeros all misses are described.
    """
    words = _Words(problem)
    disturbances = [
        error
        for reading in rollout.misreadings.values()
        for error in words.find_errors(reading, bool(tape.any()))
    ]
    least = 0.05 * float(np.linalg.norm(tape))  # below it, a stretch of raw noise is only counted
    for channel in words.list_raw_channels(rollout.misreadings if disturbances else ()):
        disturbances += words.find_peaks(channel, tape[:, channel], least)
    for k, (value, score) in enumerate(words.list_draws(rollout)):
        if abs(score) > 0.5:  # a usual draw needs no words
            disturbances.append(words.tell_draw(k, value, score))
    return sorted(dict.fromkeys(disturbances), key=lambda each: each.step)


def find_common_noise(
    problem: Problem, tapes: Floats, rollouts: Sequence[ReplayedRollout], shares: Floats, effective: float
) -> list[Disturbance]:
    """Describe how the noise of a sample of rollouts differs from chance, the largest difference first.

    Means and squares of standard normal numbers in time windows are compared with chance;
    windows that stand out on the same side, with at most one between them, are one.

    Args:
        problem: Problem with named noise, or not.
        tapes: (F, steps + 1, noise_size).
        rollouts: Their replays.
        shares: (F,) what each stands for; they add up to 1.
        effective: Number of independent rollouts that tell as much.
    """
    words, disturbances = _Words(problem), []
    moments = [np.einsum("f,ftc->ct", shares, power) for power in (tapes, tapes**2)]
    for channel, (mean, square) in enumerate(zip(*moments, strict=True)):
        last_step = 0 if channel < words.drawn else problem.steps
        for sign, first, last in _find_telling(mean[: last_step + 1], square, effective):
            window, count = slice(first, last + 1), effective * (last - first + 1)
            shift, size = float(mean[window].mean()), math.sqrt(square[window].mean())
            text = f"{size:.2g} times as large as usual {format_span(first, last, problem.dt)}"
            each = Disturbance(words.names[channel], text, first, (size**2 - 1.0) * math.sqrt(count / 2.0))
            if sign:
                magnitude = abs(shift) * math.sqrt(count)
                each = words.tell_mean(channel, (first, last), shift, rollouts, shares, magnitude)
            disturbances.append(each)
    return sorted(disturbances, key=lambda each: -each.magnitude)[:_MAX_WINDOWS]


def _find_telling(mean: Floats, square: Floats, effective: float) -> list[tuple[int, int, int]]:
    """Return the stretches that differ from chance: by the sign of their mean, or 0 by their size alone."""
    stretches: list[tuple[int, int, int]] = []
    steps = np.arange(1, len(mean))
    chance = 4.0  # standard errors up to which noise may be chance
    for window in [np.zeros(1, dtype=np.int64), *np.array_split(steps, min(_WINDOWS, max(len(steps), 1)))]:
        count = effective * len(window)
        if not len(window):
            continue
        shift = float(mean[window].mean()) * math.sqrt(count)
        size = (float(square[window].mean()) - 1.0) * math.sqrt(count / 2.0)
        if max(abs(shift), size) < chance:
            continue
        sign = int(np.sign(shift)) if abs(shift) >= chance else 0
        first, last = int(window[0]), int(window[-1])
        if stretches and stretches[-1][0] == sign and first - stretches[-1][2] - 1 <= len(window):
            first = stretches.pop()[1]
        stretches.append((sign, first, last))
    return stretches


class _Words:
    """Words for the noise of one problem.

    Attributes:
        names: Names of the numbers of a step.
        drawn: Number of the first of them that draw options; only step 0 has these.
    """

    def __init__(self, problem: Problem) -> None:
        system = problem.system
        self.names, self._perfect = find_noise_names(system), find_perfect_noise(system)
        self._loop = system if isinstance(system, ClosedLoop) else None
        self.drawn = 0 if self._loop is None or self._loop.start is None else self._loop.start.size
        # stretches as near as 3 % of the steps are joined
        self._dt, self._gap = problem.dt, max(1, round(0.03 * problem.steps))

    def list_raw_channels(self, misread: Collection[str]) -> list[int]:
        """Return the channels that neither drawn options nor errors of these names describe."""
        seen = range(0)
        if misread and self._loop is not None and self._loop.perception is not None:
            begin = self._loop.world_noise
            seen = range(begin, begin + self._loop.perception.noise_size)
        return [
            channel
            for channel in range(self.drawn, len(self.names))
            if channel not in seen and self.names[channel] not in misread
        ]

    def list_draws(self, rollout: ReplayedRollout) -> list[tuple[float, float]]:
        """Return the drawn values of a rollout, each with its normal score."""
        # Not the numbers of the tape, which are scores only where nothing is correlated or drawn again.
        if self._loop is None or self._loop.start is None or not rollout.states:
            return []
        values = rollout.states[0].drawn.values[0].tolist()
        laws = self._loop.start.draws.laws
        return [(value, float(law.score(value))) for value, law in zip(values, laws, strict=True)]

    def tell_draw(self, number: int, value: float, score: float) -> Disturbance:
        """Return a drawn option in words."""
        name = self.names[number].removeprefix("draw of ")
        return Disturbance(name, f"is {value:.4g} ({score:+.2g} sigma)", 0, abs(score))

    def find_peaks(self, channel: int, numbers: Floats, least: float) -> Iterator[Disturbance]:
        """Yield the stretches of a channel in which its numbers (steps + 1,) have one sign.

        Those whose norm is below ``least`` have no magnitude.
        """
        for sign in (1.0, -1.0):
            for first, last in _find_stretches(sign * numbers > 0.0, self._gap):
                section = np.maximum(sign * numbers[first : last + 1], 0.0)
                upto = "" if first == last else "up to "
                text = f"{upto}{sign * section.max():+.2g} sigma {format_span(first, last, self._dt)}"
                norm = float(np.linalg.norm(section))
                yield Disturbance(self.names[channel], text, first, norm if norm >= least else 0.0)

    def find_errors(self, reading: Misreading, noisy: bool) -> Iterator[Disturbance]:
        """Yield the stretches in which a reading (T,) fails, or is much farther off than without noise."""
        values, usual = reading.values, np.broadcast_to(reading.usual, reading.values.shape)
        lost, expected = np.isnan(values), np.isnan(usual)
        for mask, verb in (
            (lost & ~expected if noisy else lost, "missed"),
            (~lost & expected & noisy, "detected (missed without noise)"),
        ):
            for first, last in _find_stretches(mask, 0):
                text = f"{verb} {format_span(first, last, self._dt)}"
                yield Disturbance(reading.subject, text, first, 1.0 + last - first)
        if not reading.above:
            return
        errors = np.where(values != usual, np.nan_to_num(values), 0.0)
        limit = max(_NEUTRAL_FACTOR * float(np.nan_to_num(np.abs(usual)).max(initial=0.0)), reading.least)
        # smaller than a quarter of the greatest error: left out
        limit = max(limit, 0.25 * float(np.abs(errors).max(initial=0.0)))
        for sign in (1.0, -1.0):
            for first, last in _find_stretches(sign * errors > limit, self._gap):
                peak = sign * float((sign * errors[first : last + 1]).max())
                text = f"{_tell_error(reading, peak)} {format_span(first, last, self._dt)}"
                yield Disturbance(reading.subject, text, first, abs(peak) / limit)

    def tell_mean(
        self,
        channel: int,
        stretch: tuple[int, int],
        shift: float,
        rollouts: Sequence[ReplayedRollout],
        shares: Floats,
        magnitude: float,
    ) -> Disturbance:
        """Return in words what numbers of a channel do whose mean over rollouts is ``shift`` in a stretch."""
        name = self.names[channel]
        if channel < self.drawn:
            draws = np.array([self.list_draws(rollout)[channel] for rollout in rollouts])
            value, score = (shares @ draws).tolist()
            each = self.tell_draw(channel, value, score)
            return Disturbance(each.subject, f"{each.text} on average", 0, magnitude)
        readings = [rollout.misreadings[name] for rollout in rollouts if name in rollout.misreadings]
        if len(readings) < len(rollouts):
            text = f"{shift:+.2g} sigma on average {format_span(*stretch, self._dt)}"
            return Disturbance(name, text, stretch[0], magnitude)
        errors = np.full((len(readings), max(len(reading.values) for reading in readings)), np.nan)
        going = np.zeros(errors.shape)
        for row, reading in enumerate(readings):
            errors[row, : len(reading.values)] = reading.values
            going[row, : len(reading.values)] = shares[row]
        if readings[0].above:
            sizes = _average(errors, going)
        else:
            lucky = shift * self._perfect[channel] > 0.0
            sizes = _average(np.where(np.isnan(errors) != lucky, 1.0, 0.0), going)
        first, last, size = _find_plateau(sizes, *stretch)
        text = f"{_tell_error(readings[0], size)} on average"
        if not readings[0].above:
            share = float(sizes[first : last + 1].mean())
            text = f"{'detected' if lucky else 'missed'} {100.0 * share:.0f} % of the time"
        span = format_span(first, last, self._dt)
        return Disturbance(readings[0].subject, f"{text} {span}", first, magnitude)


def _average(values: Floats, weights: Floats) -> Floats:
    """Return the weighted means (T,) of values (F, T) that are not NaN."""
    present_weights = np.where(np.isnan(values), 0.0, weights)
    sums = np.einsum("ft,ft->t", present_weights, np.nan_to_num(values))
    return np.asarray(sums / np.maximum(present_weights.sum(axis=0), 1e-300))


def _find_plateau(sizes: Floats, first: int, last: int) -> tuple[int, int, float]:
    """Return the steps around the greatest size (T,) in a stretch at which it is at least half as large."""
    last = min(last, len(sizes) - 1)
    peak = first + int(np.argmax(np.abs(sizes[first : last + 1])))
    large = sizes * np.sign(sizes[peak]) >= 0.5 * abs(sizes[peak])
    begin, end = next(span for span in _find_stretches(large, 0) if span[0] <= peak <= span[1])
    return begin, end, float(sizes[peak])


def _tell_error(reading: Misreading, size: float) -> str:
    return (reading.above if size > 0.0 else reading.below).format(f"{abs(size):.2g}")


def _find_stretches(mask: Bools, gap: int) -> list[tuple[int, int]]:
    """Return the first and last step of each stretch in which a mask (T,) holds, but for short gaps."""
    stretches: list[tuple[int, int]] = []
    for step in np.flatnonzero(mask).tolist():
        first = stretches.pop()[0] if stretches and step - stretches[-1][1] <= gap + 1 else step
        stretches.append((first, step))
    return stretches
