"""Description of what a proposal has learnt: which noise, when, and in which share of the failures.

A failure belongs to the component of the proposal that made it likely: with probability a_j g_j / q, the
responsibility of expectation-maximisation, or to the target itself (Bishop 2006, equation 9.13).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from avrare.estimation.result.note import Note
from avrare.protocols import Floats
from avrare.rollout.noise_words import format_span
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare.stack.noise_names import find_noise_names
from avrare_estimators.common.samples.sampling import Sample
from avrare_estimators.common.samples.sources import TapeSource
from avrare_estimators.common.tapes.atoms import Atoms, along_atoms
from avrare_estimators.common.tapes.tape_mixture import NONE, TapeMixture
from avrare_estimators.common.weights import resample

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
        return NoiseNames(find_noise_names(problem.system), problem.dt)


@dataclass(frozen=True)
class Cause:
    """Cause of a share of the failures.

    Attributes:
        note: The cause in words.
        data: JSON: ``noise`` (names), ``share``, and where known ``from`` and ``to`` (steps).
    """

    note: Note
    data: dict[str, Any]


def describe_failures(samples: Sequence[Sample], names: NoiseNames) -> list[Cause]:
    """Return the causes of the failures, the most frequent first; empty where none is known."""
    sample = samples[0]
    source = sample.source
    assert isinstance(source, TapeSource)
    failing = np.flatnonzero(sample.violated)
    if source.mixture is None or not len(failing):
        return []
    weights = np.exp(sample.log_weights[failing])
    chosen = failing[resample(weights, min(len(failing), _MOST_FAILURES), 0.5)]
    return describe_tapes(source.mixture, sample.tapes(chosen), sample.share, names)


def describe_tapes(mixture: TapeMixture, tapes: Floats, target: float, names: NoiseNames) -> list[Cause]:
    """Return the causes of failures of equal weights; ``target`` is the share of the target in the law."""
    explained = Explained(mixture, along_atoms(mixture.atoms, tapes))
    shares, rest = _responsibilities(explained, target)
    bundles = _bundles(mixture)
    causes = [_describe(explained, bundle, shares[:, bundle], names) for bundle in bundles]
    causes.sort(key=lambda cause: -cause.data["share"])
    frequent = [cause for cause in causes if cause.data["share"] >= _LEAST_SHARE]
    rest += sum(cause.data["share"] for cause in causes[len(frequent) :])
    if rest >= _LEAST_SHARE:
        note = Note("cause", f"No single cause was found for {rest:.0%} of the failures.")
        frequent.append(Cause(note, {"noise": [], "share": round(rest, 4)}))
    return frequent


@dataclass(frozen=True)
class Explained:
    """F failures beside the mixture that explains them.

    Attributes:
        mixture: The mixture, of A atoms.
        along: (F, A) noise of each failure along the direction of each atom.
    """

    mixture: TapeMixture
    along: Floats

    @cached_property
    def logs(self) -> Floats:
        """Log g/p (F, A)."""
        return self.mixture.atoms.logs(self.along, np.ones(1))


def _responsibilities(explained: Explained, target: float) -> tuple[Floats, float]:
    """Return the share (F, J) of each failure in each component, and the mean share of the target."""
    logs = explained.mixture.component_logs(explained.logs) + np.log1p(-target)
    logs = np.concatenate([logs, np.full((len(logs), 1), np.log(max(target, 1e-12)))], axis=1)
    shares = np.exp(logs - np.logaddexp.reduce(logs, axis=1)[:, None])
    return shares[:, :-1], float(shares[:, -1].mean())


def _bundles(mixture: TapeMixture) -> list[list[int]]:
    """Return the components of each cause: of the same channels, in windows that overlap or nearly do."""
    atoms, windows = mixture.atoms, []
    for j, parts in enumerate(mixture.parts.tolist()):
        groups = [mixture.groups[part][0] for part in parts if part != NONE]
        channels = [int(atoms.channel[index[0]]) for index in groups]
        first, last = int(atoms.first[groups[0]].min()), int(atoms.last[groups[0]].max())
        # Those of two noises belong together at any time.
        windows.append((channels, *((first, last) if len(groups) == 1 else (0, 0)), j))
    bundles: list[list[int]] = []
    channels, end = [NONE], 0
    for others, first, last, j in sorted(windows):
        if others == channels and first - end <= _GAP:
            bundles[-1].append(j)
            end = max(end, last)
        else:
            bundles.append([j])
            channels, end = others, last
    return bundles


def _describe(explained: Explained, bundle: list[int], shares: Floats, names: NoiseNames) -> Cause:
    mixture = explained.mixture
    share = float(shares.sum() / len(shares))
    parts, spans, noise = [], [], []
    for k in range(int((mixture.parts[bundle[0]] != NONE).sum())):
        atoms, sizes = [], []
        for j in bundle:
            # Each failure belongs to the atom of the group that explains it best.
            index, weights = mixture.groups[mixture.parts[j, k]]
            atoms.append(index[(explained.logs[:, index] + np.log(weights)).argmax(axis=1)])
            sizes.append(explained.along[np.arange(len(shares)), atoms[-1]])
        atom, weight = np.concatenate(atoms), shares.T.reshape(-1)
        first, last = _span(mixture.atoms, atom, weight)
        noise.append(names.noise[mixture.atoms.channel[atom[0]]])
        how = _how(np.concatenate(sizes), weight) + _summed(mixture.atoms, atom, weight)
        parts.append(f"{noise[-1]} {how} {format_span(first, last, names.dt)}")
        spans.append((first, last))
    first_steps, last_steps = map(list, zip(*spans, strict=True))
    data = {"noise": noise, "from": first_steps, "to": last_steps, "share": round(share, 4)}
    return Cause(Note("cause", f"Cause: {' and '.join(parts)}, in {share:.0%} of the failures."), data)


def _span(atoms: Atoms, index: Integers, weight: Floats) -> tuple[int, int]:
    """Return the steps between which 80 % of the atoms' shares lie."""
    first, last = (np.asarray(part[index], dtype=np.float64) for part in (atoms.first, atoms.last))
    return int(_quantile(first, weight, 0.1)), int(_quantile(last, weight, 0.9))


def _summed(atoms: Atoms, index: Integers, weight: Floats) -> str:
    """Return `` in sum`` where most directions have several steps: no single number need be large there."""
    several = atoms.first[index] < atoms.last[index]
    return " in sum" if weight[several].sum() > 0.5 * weight.sum() else ""


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
