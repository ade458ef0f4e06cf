"""Description of what a proposal has learnt: which noise, when, and in which share of the failures.

A failure belongs to the component of the proposal that made it likely: with probability a_j g_j / q, the
responsibility of expectation-maximisation, or to the target itself (Bishop 2006, equation 9.13).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.stack.noise_names import find_noise_names, find_time_step
from avrare_estimators.importance.atoms import Atoms, Group, Row, log_ratios
from avrare_estimators.importance.sampling import Sample, TapeSource
from avrare_estimators.importance.tape_mixture import TapeMixture
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
    return describe_tapes(source.mixture, sample.tapes(chosen), sample.share, names)


def describe_tapes(
    mixture: TapeMixture, tapes: Floats, target: float, names: NoiseNames
) -> list[dict[str, Any]]:
    """Return the causes of failures of equal weights; ``target`` is the share of the target in the law."""
    shares, rest = _responsibilities(mixture, tapes, target)
    causes = sorted(_causes(mixture, tapes, shares, names), key=lambda cause: -cause["share"])
    told = [cause for cause in causes if cause["share"] >= _LEAST_SHARE]
    rest += sum(cause["share"] for cause in causes[len(told) :])
    if rest >= _LEAST_SHARE:
        text = f"no single cause was found for {rest:.0%} of the failures"
        told.append({"noise": [], "share": round(rest, 4), "text": text})
    return told


def _responsibilities(mixture: TapeMixture, tapes: Floats, target: float) -> tuple[Floats, float]:
    """Return the share (F, J) of each failure in each component, and the mean share of the target."""
    logs = mixture.component_logs(log_ratios(mixture.atoms, tapes)) + np.log1p(-target)
    logs = np.concatenate([logs, np.full((len(logs), 1), np.log(max(target, 1e-12)))], axis=1)
    shares = np.exp(logs - np.logaddexp.reduce(logs, axis=1)[:, None])
    return shares[:, :-1], float(shares[:, -1].mean())


def _causes(mixture: TapeMixture, tapes: Floats, shares: Floats, names: NoiseNames) -> list[dict[str, Any]]:
    """Return causes: components of the same channels, close to each other in time."""
    own = mixture.components
    order = sorted(range(len(own)), key=lambda j: (_signature(own[j][1]), _place(own[j][1])))
    bundles: list[list[int]] = []
    for j in order:
        near = bundles and _signature(own[bundles[-1][-1]][1]) == _signature(own[j][1])
        if near and _place(own[j][1]) - _place(own[bundles[-1][-1]][1]) <= _GAP:
            bundles[-1].append(j)
        else:
            bundles.append([j])
    return [_tell([own[j][1] for j in bundle], shares[:, bundle], tapes, names) for bundle in bundles]


def _signature(groups: Sequence[Group]) -> list[int]:
    """Return the channel of each group."""
    return [int(next(iter(group))[0]) for group in groups]


def _place(groups: Sequence[Group]) -> float:
    """Return the step by which to part causes in time; those of two noises belong together."""
    return next(iter(groups[0]))[2] if len(groups) == 1 else 0.0


def _tell(
    bundle: Sequence[Sequence[Group]], shares: Floats, tapes: Floats, names: NoiseNames
) -> dict[str, Any]:  # fmt: skip
    share = float(shares.sum() / len(tapes))
    parts, spans = [], []
    channels = _signature(bundle[0])
    for k, channel in enumerate(channels):
        rows: dict[Row, float] = {}
        sizes, weights = [], []
        for groups, weight in zip(bundle, shares.T, strict=True):
            # Each failure belongs to the atom of the group that explains it best.
            atoms = Atoms.of(list(groups[k]))
            own = log_ratios(atoms, tapes) + np.log(list(groups[k].values()))
            best = own.argmax(axis=1)
            for a, row in enumerate(groups[k]):
                mine = best == a
                rows[row] = rows.get(row, 0.0) + float(weight[mine].sum())
                sizes.append(_size(row, tapes[mine]))
                weights.append(weight[mine])
        first, last = _span(rows)
        size = _how(np.concatenate(sizes), np.concatenate(weights))
        parts.append(f"{names.noise[channel]} {size} {names.span(first, last)}")
        spans.append((first, last))
    return {
        "noise": [names.noise[channel] for channel in channels],
        "from": [first for first, _ in spans], "to": [last for _, last in spans],
        "share": round(share, 4), "text": f"{' and '.join(parts)}, in {share:.0%} of the failures",
    }  # fmt: skip


def _size(row: Row, tapes: Floats) -> Floats:
    """Return the noise (F,) of an atom along its direction."""
    return np.asarray(tapes[:, :, int(row[0])] @ Atoms.of([row]).vectors(tapes.shape[1] - 1)[0])


def _span(rows: dict[Row, float]) -> tuple[int, int]:
    """Return the steps between which 80 % of the atoms' shares lie."""
    first, last = (np.array([row[k] for row in rows]) for k in (1, 2))
    weight = np.array(list(rows.values()))
    return int(_quantile(first, weight, 0.1)), int(_quantile(last, weight, 0.9))


def _how(sizes: Floats, weights: Floats) -> str:
    typical = np.floor(2.0 * _quantile(np.abs(sizes), weights, 0.25)) / 2.0
    above = float(weights[sizes > 0].sum() / max(weights.sum(), 1e-300))
    if above > _ONE_SIDED:
        return f"above {typical:g} sigma"
    return f"below -{typical:g} sigma" if above < 1.0 - _ONE_SIDED else f"beyond {typical:g} sigma"


def _quantile(values: Floats, weights: Floats, share: float) -> float:
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weights[order]) >= share * weights.sum()
    return float(values[order][min(int(np.argmax(reached)), len(values) - 1)])
