"""What a proposal has learnt, in words: which noise, when, and in which share of the failures.

A failure belongs to the component of the proposal that made it likely: with probability a_j g_j / q, the
responsibility of expectation-maximisation, or to the target itself (Bishop 2006, equation 9.13).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.protocols import Floats, find_noise_names, find_time_step
from avrare.rollout.problem import Problem
from avrare_estimators.importance.sampling import Sample, TapeSource
from avrare_estimators.importance.tape_mixture import NO_ATOM, Row, TapeMixture
from avrare_estimators.weights import resample

_MOST_FAILURES = 500
_LEAST_SHARE = 0.03
_GAP = 3
"""Steps without an atom that part two causes in time."""
_ONE_SIDED = 0.9


@dataclass(frozen=True)
class NoiseNames:
    """Names of a problem's noise.

    Attributes:
        noise: Name of each channel.
        dt: Seconds of a step; None: time is counted in steps.
    """

    noise: tuple[str, ...]
    dt: float | None

    @staticmethod
    def of(problem: Problem) -> NoiseNames:
        """Return the names that the parts of a system declare."""
        return NoiseNames(find_noise_names(problem.system), find_time_step(problem.system))

    def span(self, first: int, last: int) -> str:
        """Return ``at 1.9-2.8 s`` or ``at steps 19-28``."""
        if self.dt is None:
            return f"at step {first}" if first == last else f"at steps {first}-{last}"
        low, high = f"{first * self.dt:.3g}", f"{last * self.dt:.3g}"
        return f"at {low} s" if low == high else f"at {low}-{high} s"


@dataclass
class _Cause:
    """Failures that one noise, or two, brought about.

    Attributes:
        channel: Channels of its atoms.
        wide: Whether each atom widens one step, or shifts a window.
        share: Share of the failures.
        rows: Atoms and shares of its components.
        sizes: Sizes of each atom's noise and their weights.
    """

    channel: tuple[int, ...]
    wide: tuple[bool, ...]
    share: float
    rows: list[tuple[list[Row], float]]
    sizes: list[tuple[Floats, Floats]]


def describe_failures(samples: Sequence[Sample], names: NoiseNames) -> list[dict[str, Any]]:
    """Return the causes of the failures, the most frequent first; empty where there are none to tell.

    Each has ``noise`` (names), ``from`` and ``to`` (steps), ``share`` and ``text``.
    """
    sample = samples[0]
    source = sample.source
    assert isinstance(source, TapeSource)
    failing = np.flatnonzero(sample.violated)
    if source.mixture is None or not len(failing):
        return []
    weights = np.exp(sample.log_weights[failing])
    chosen = failing[resample(weights, min(len(failing), _MOST_FAILURES), 0.5)]
    tapes = sample.tapes(chosen)
    shares, rest = _responsibilities(source.mixture, tapes, sample.share)
    causes = _causes(source.mixture, tapes, shares)
    told = [_tell(cause, names) for cause in sorted(causes, key=lambda cause: -cause.share)]
    told = [entry for entry in told if entry["share"] >= _LEAST_SHARE]
    rest += sum(cause.share for cause in causes) - sum(entry["share"] for entry in told)
    if rest >= _LEAST_SHARE:
        text = f"no single cause was found for {rest:.0%} of the failures"
        told.append({"noise": [], "share": round(rest, 4), "text": text})
    return told


def _responsibilities(mixture: TapeMixture, tapes: Floats, target: float) -> tuple[Floats, float]:
    """Return the share (F, J) of each failure in each component, and the mean share of the target."""
    logs = mixture.components(mixture.sums(tapes)) + np.log1p(-target)
    logs = np.concatenate([logs, np.full((len(logs), 1), np.log(max(target, 1e-12)))], axis=1)
    shares = np.exp(logs - np.logaddexp.reduce(logs, axis=1)[:, None])
    return shares[:, :-1], float(shares[:, -1].mean())


def _causes(mixture: TapeMixture, tapes: Floats, shares: Floats) -> list[_Cause]:
    rows = mixture.atoms.rows
    own = [[rows[a] for a in sorted(p for p in parts if p != NO_ATOM)] for parts in mixture.parts.tolist()]
    by_place = sorted(range(len(own)), key=lambda j: (_signature(own[j]), own[j][0][2]))
    causes: list[_Cause] = []
    last: tuple[Any, float] | None = None
    for j in by_place:
        signature, place = _signature(own[j]), own[j][0][2]
        if last is None or last[0] != signature or (signature[1][0] and place - last[1] > _GAP):
            causes.append(_Cause(signature[0], signature[1], 0.0, [], []))
        last = signature, place
        cause, weight = causes[-1], shares[:, j] / len(tapes)
        cause.share += float(weight.sum())
        cause.rows.append((own[j], float(weight.sum())))
        cause.sizes += [(_size(row, tapes), weight) for row in own[j][:1]] if len(own[j]) == 1 else []
    return causes


def _signature(rows: list[Row]) -> tuple[tuple[int, ...], tuple[bool, ...], tuple[bool, ...]]:
    return (
        tuple(int(row[0]) for row in rows), tuple(row[4 + 1] != 1.0 for row in rows),
        tuple(row[3] > 0 for row in rows),
    )  # fmt: skip


def _size(row: Row, tapes: Floats) -> Floats:
    """Return the noise (F,) of an atom: its value, or the mean over its window."""
    channel, first, last = (int(value) for value in row[:3])
    return np.asarray(tapes[:, first : last + 1, channel].mean(axis=1))


def _tell(cause: _Cause, names: NoiseNames) -> dict[str, Any]:
    parts, spans = [], []
    for k, (channel, wide) in enumerate(zip(cause.channel, cause.wide, strict=True)):
        first, last = _span([(rows[k], share) for rows, share in cause.rows])
        name, when = names.noise[channel], names.span(first, last)
        parts.append(f"{name} {_how(cause, wide, cause.rows[0][0][k])} {when}")
        spans.append((first, last))
    text = f"{' and '.join(parts)}, in {cause.share:.0%} of the failures"
    return {
        "noise": [names.noise[channel] for channel in cause.channel],
        "from": [first for first, _ in spans], "to": [last for _, last in spans],
        "share": round(cause.share, 4), "text": text,
    }  # fmt: skip


def _span(rows: list[tuple[Row, float]]) -> tuple[int, int]:
    """Return the steps between which 80 % of the components' atoms lie."""
    first, last = (np.array([row[k] for row, _ in rows]) for k in (1, 2))
    weight = np.array([share for _, share in rows])
    return int(_quantile(first, weight, 0.1)), int(_quantile(last, weight, 0.9))


def _how(cause: _Cause, wide: bool, row: Row) -> str:
    if not cause.sizes:
        return "far out" if wide else ("raised" if row[3] > 0 else "lowered")
    sizes, weights = (np.concatenate(part) for part in zip(*cause.sizes, strict=True))
    typical = _quantile(np.abs(sizes), weights, 0.25 if wide else 0.5)
    if not wide:
        return f"{'raised' if row[3] > 0 else 'lowered'} by {typical:.1f} sigma"
    above = float(weights[sizes > 0].sum() / weights.sum())
    side = "above " if above > _ONE_SIDED else "below -" if above < 1.0 - _ONE_SIDED else "beyond "
    return f"{side}{np.floor(2.0 * typical) / 2.0:g} sigma"


def _quantile(values: Floats, weights: Floats, share: float) -> float:
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weights[order]) >= share * weights.sum()
    return float(values[order][min(int(np.argmax(reached)), len(values) - 1)])
