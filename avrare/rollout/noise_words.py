"""Words for noise: its kind, size, side and time; the same wherever noise is described."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from avrare.protocols import Bools, Floats, Misreading
from avrare.rollout.problem import Problem
from avrare.rollout.replay import ReplayedRollout, replay_tape
from avrare.stack.closed_loop import ClosedLoop
from avrare.stack.part_checks import find_noise_names, find_perfect_noise

_SMALL_SHARE = 0.25
"""Share of the greatest error or sum of a channel, and of a tape's norm, below which others are left out."""
_MIN_STANDARD_ERRORS = 4.0
"""Standard errors from which on the size of noise in a window is set apart from chance."""


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
        subject: Name of the disturbed quantity.
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
    """Describe noise (steps + 1, noise_size) in one sentence; zero noise by the vehicles that are missed."""
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
    least = _SMALL_SHARE * float(np.linalg.norm(tape))
    for channel in words.list_raw_channels(rollout.misreadings if disturbances else ()):
        for drift in _find_drifts(tape[:, channel], 1e-300):
            each = words.describe_sum(channel, drift)
            disturbances.append(each if each.magnitude >= least else replace(each, magnitude=0.0))
    for k, (value, score) in enumerate(words.list_draws(rollout)):
        least_score = 0.5  # normal score above which a drawn option is described
        if abs(score) > least_score:
            disturbances.append(words.describe_draw(k, value, score))
    return sorted(dict.fromkeys(disturbances), key=lambda each: each.step)


def find_common_noise(
    problem: Problem, tapes: Floats, rollouts: Sequence[ReplayedRollout], shares: Floats, effective: float
) -> list[Disturbance]:
    """Describe how the noise of a sample of rollouts differs from chance, the largest difference first.

    Sums of the mean noise over stretches of time are compared with chance, and where none stands out the
    squares in time windows.

    Args:
        problem: Problem with named noise, or not.
        tapes: (F, steps + 1, noise_size).
        rollouts: Their replays.
        shares: (F,) their weights; they add up to 1.
        effective: Number of independent rollouts that tell as much.
    """
    words = _Words(problem)
    disturbances = list(words.find_common_draws(rollouts, shares, effective))
    means, squares = (np.einsum("f,ftc->ct", shares, power) for power in (tapes, tapes**2))
    for channel in range(words.drawn, len(words.names)):
        # standard errors from which the sum of a stretch is described: there are more stretches than windows
        standard_errors = 5.0
        drifts = list(_find_drifts(means[channel], standard_errors / math.sqrt(effective)))
        wide = [] if drifts else list(words.find_wide_windows(channel, squares[channel], effective))
        if drifts or wide:
            magnitude = max([abs(score) for _, _, score in drifts] + [each.magnitude for each in wide])
            disturbances += words.describe_mean(channel, drifts, rollouts, shares, magnitude) or wide
    return sorted(disturbances, key=lambda each: -each.magnitude)[:3]


def _find_drifts(numbers: Floats, least: float) -> Iterator[tuple[int, int, float]]:
    """Yield stretches of numbers (T,) by time: first and last step, and their sum in its standard deviations.

    The stretch with the least likely sum is found, then those before and after it that are at least a quarter
    as unlikely; sums below ``least`` are left out.
    """
    if not len(numbers):
        return
    sums = np.concatenate([np.zeros(1), np.cumsum(numbers)])
    most_lengths = 100  # lengths of a stretch that are tried
    lengths = np.unique(np.geomspace(1.0, len(numbers), most_lengths).round().astype(np.int64)).tolist()
    scores = [(sums[length:] - sums[:-length]) / math.sqrt(length) for length in lengths]
    peaks = np.array([float(np.abs(score).max()) for score in scores])
    near_peak_share = 0.95  # share of the least likely sum above which a longer stretch is preferred
    longest = int(np.flatnonzero(peaks >= near_peak_share * peaks.max())[-1])
    first = int(np.argmax(np.abs(scores[longest])))
    sign = np.sign(scores[longest][first])
    same_sign = first + np.flatnonzero(numbers[first : first + lengths[longest]] * sign > 0.0)
    if peaks.max() < least or not len(same_sign):
        return
    first, last = int(same_sign[0]), int(same_sign[-1])
    score = float(sums[last + 1] - sums[first]) / math.sqrt(last + 1 - first)
    least = max(least, _SMALL_SHARE * abs(score))
    yield from _find_drifts(numbers[:first], least)
    yield first, last, score
    for begin, end, later in _find_drifts(numbers[last + 1 :], least):
        yield last + 1 + begin, last + 1 + end, later


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
        largest_gap_share = 0.03  # share of a rollout's steps between two stretches that are joined
        self._dt, self._gap = problem.dt, max(1, round(largest_gap_share * problem.steps))

    def list_raw_channels(self, misread: Collection[str]) -> list[int]:
        """Return the channels that neither drawn options nor errors of these names describe."""
        described = range(0)
        if misread and self._loop is not None and self._loop.perception is not None:
            begin = self._loop.world_noise
            described = range(begin, begin + self._loop.perception.noise_size)
        return [
            channel
            for channel in range(self.drawn, len(self.names))
            if channel not in described and self.names[channel] not in misread
        ]

    def list_draws(self, rollout: ReplayedRollout) -> list[tuple[float, float]]:
        """Return the drawn values of a rollout, each with its normal score."""
        # Not the numbers of the tape, which are scores only where nothing is correlated or drawn again.
        if self._loop is None or self._loop.start is None or not rollout.states:
            return []
        values = rollout.states[0].drawn.values[0].tolist()
        laws = self._loop.start.draws.laws
        return [(value, float(law.score(value))) for value, law in zip(values, laws, strict=True)]

    def describe_draw(self, number: int, value: float, score: float) -> Disturbance:
        """Describe a drawn option."""
        name = self.names[number].removeprefix("draw of ")
        return Disturbance(name, f"is {value:.4g} ({score:+.2g} sigma)", 0, abs(score))

    def find_common_draws(
        self, rollouts: Sequence[ReplayedRollout], shares: Floats, effective: float
    ) -> Iterator[Disturbance]:
        """Yield the drawn options whose mean over rollouts differs from chance, or whose range does."""
        draws = [self.list_draws(rollout) for rollout in rollouts]
        if not all(draws):
            return
        for number, (values, scores) in enumerate(np.array(draws).transpose(1, 2, 0)):
            value, score = float(shares @ values), float(shares @ scores)
            narrowness = (1.0 - float(shares @ (scores - score) ** 2)) / math.sqrt(2.0)
            if abs(score) * math.sqrt(effective) >= _MIN_STANDARD_ERRORS:
                yield self.describe_draw(number, value, score)
            elif narrowness * math.sqrt(effective) >= _MIN_STANDARD_ERRORS:
                text = f"is between {values.min():.3g} and {values.max():.3g}"
                yield replace(self.describe_draw(number, value, score), text=text, magnitude=narrowness)

    def describe_sum(self, channel: int, drift: tuple[int, int, float]) -> Disturbance:
        """Describe the sum of a channel's numbers over a stretch, in standard deviations of that sum."""
        first, last, score = drift
        total = " in sum" if last > first else ""
        text = f"{score:+.2g} sigma{total} {format_span(first, last, self._dt)}"
        return Disturbance(self.names[channel], text, first, abs(score))

    def find_wide_windows(self, channel: int, squares: Floats, effective: float) -> Iterator[Disturbance]:
        """Yield the time windows in which the mean squares (T,) of a channel are larger than chance."""
        windows = 8
        edges = np.unique(np.linspace(1, len(squares), windows + 1).astype(np.int64))
        wide = np.zeros(len(squares), dtype=bool)
        for first, end in zip([0, *edges[:-1]], edges, strict=True):
            excess = float(squares[first:end].mean()) - 1.0
            wide[first:end] = excess * math.sqrt(effective * (end - first) / 2.0) >= _MIN_STANDARD_ERRORS
        for first, last in _find_stretches(wide, len(squares) // windows):
            square = float(squares[first : last + 1].mean())
            span = format_span(first, last, self._dt)
            text = f"{math.sqrt(square):.2g} times as large as usual to both sides {span}"
            magnitude = (square - 1.0) * math.sqrt((last - first + 1) / 2.0)
            yield Disturbance(self.names[channel], text, first, magnitude)

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
        factor = 3.0  # errors are described above this multiple of the largest one without noise
        limit = max(factor * float(np.nan_to_num(np.abs(usual)).max(initial=0.0)), reading.least)
        limit = max(limit, _SMALL_SHARE * float(np.abs(errors).max(initial=0.0)))
        for sign in (1.0, -1.0):
            for first, last in _find_stretches(sign * errors > limit, self._gap):
                sizes = sign * errors[first : last + 1]
                peak = float(sizes.max())
                even_share = 0.9  # share of its peak above which the mean of an error is as good as even
                size = f"{'up to ' * bool(sizes.mean() < even_share * peak)}{peak:.2g}"
                text = (reading.above if sign > 0.0 else reading.below).format(size)
                text = f"{text} {format_span(first, last, self._dt)}"
                yield Disturbance(reading.subject, text, first, peak / limit)

    def describe_mean(
        self,
        channel: int,
        drifts: Sequence[tuple[int, int, float]],
        rollouts: Sequence[ReplayedRollout],
        shares: Floats,
        magnitude: float,
    ) -> list[Disturbance]:
        """Describe the average of a channel over rollouts; ``drifts`` are those of its mean.

        Without drifts only a detection is described; the largest disturbance gets the ``magnitude``.
        """
        name = self.names[channel]
        readings = [rollout.misreadings[name] for rollout in rollouts if name in rollout.misreadings]
        if len(readings) < len(rollouts):
            return [self.describe_sum(channel, drift) for drift in drifts]
        steps = max(len(reading.values) for reading in readings)
        errors, usual, going = np.full((3, len(readings), steps), np.nan)
        for row, reading in enumerate(readings):
            count = len(reading.values)
            errors[row, :count], usual[row, :count] = reading.values, reading.usual
            going[row, :count] = shares[row]
        if not readings[0].above:
            lucky = sum(score for _, _, score in drifts) * self._perfect[channel] > 0.0
            hits = _average(np.where(np.isnan(errors) != lucky, 1.0, 0.0), going)
            return self._describe_detection(readings[0].subject, lucky, hits, magnitude)
        if not drifts:
            return []
        mean = replace(readings[0], values=_average(errors, going), usual=_average(usual, going))
        disturbances = list(self.find_errors(mean, True)) or [
            self.describe_sum(channel, drift) for drift in drifts
        ]
        largest = max(each.magnitude for each in disturbances)
        return [replace(each, magnitude=each.magnitude / largest * magnitude) for each in disturbances]

    def _describe_detection(
        self, subject: str, lucky: bool, shares: Floats, magnitude: float
    ) -> list[Disturbance]:
        # The steps at which at least half as many rollouts detect, or miss, it as at any step.
        if not shares.any():
            return []
        first, last = max(
            _find_stretches(shares >= 0.5 * shares.max(), self._gap),
            key=lambda stretch: stretch[1] - stretch[0],
        )
        share = 100.0 * float(shares[first : last + 1].mean())
        text = f"{'detected' if lucky else 'missed'} {share:.0f} % of the time"
        return [Disturbance(subject, f"{text} {format_span(first, last, self._dt)}", first, magnitude)]


def _average(values: Floats, weights: Floats) -> Floats:
    """Return the weighted means (T,) of values (F, T), skipping NaN; 0 where all weights vanish."""
    weights = np.where(np.isnan(values), np.nan, weights)
    return np.asarray(np.nansum(values * weights, axis=0) / np.maximum(np.nansum(weights, axis=0), 1e-300))


def _find_stretches(mask: Bools, gap: int) -> list[tuple[int, int]]:
    """Return the first and last step of each stretch in which a mask (T,) holds, except for short gaps."""
    stretches: list[tuple[int, int]] = []
    for step in np.flatnonzero(mask).tolist():
        first = stretches.pop()[0] if stretches and step - stretches[-1][1] <= gap + 1 else step
        stretches.append((first, step))
    return stretches
