"""Kinds of failure: clusters of what happens in the failing rollouts, each with its own probability.

Failures are clustered by their signals over time, by the comparison that is violated first, and by when. A
kind is told by that and by the noise that sets it apart from chance. The probabilities of the kinds add up to
the estimate; their intervals take the kinds as given.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from avrare.analysis.causes.clusters import find_clusters
from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.first_violation import FirstViolation, find_first_violation
from avrare.analysis.failures.severity import describe_severities
from avrare.base.errors import UsageError
from avrare.base.number_format import describe_share, format_estimate
from avrare.base.records import Answer, Records
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Result
from avrare.protocols import Bools, Floats
from avrare.rollout.problem import Problem
from avrare.rollout.replay import ReplayedRollout, replay_tapes, tabulate_signals
from avrare.stack.noise_names import find_noise_names

METHODS = ("kmeans", "hdbscan")
_COMPONENTS = 5
"""Principal components of the features in which k-means makes clusters."""
_FEW = 5
"""Fewer failures of a kind get a warning."""
_WINDOWS = 8
_TELLING = 4.0
"""Noise of a kind is named from this many standard errors on."""
_NAMED = 2
_ONE_SIDED = 0.5
"""Share of the mean square that the mean itself has where noise is told by its mean."""
_STRAY = 4
"""So few failures are no kind of their own, unless something else is violated first."""
_APART = 4.0
"""Least separation of two kinds; a uniform law cut in the middle has 3.5, a normal one 2.7."""
_LEAST_SHARE = 0.05
"""Least share of failures for which HDBSCAN makes a kind."""


@dataclass(frozen=True)
class Kind:
    """Kind of failure.

    Attributes:
        text: What happens, when, and the noise that goes with it.
        probability: Probability of a failure of this kind.
        interval: Its interval.
        share: Share of all failures.
        members: Indices of the kept failures.
        ancestors: Number of first ancestors of these.
        representative: Index of the most typical one: the medoid.
        time: Median time of the first violation [s] (steps where there is no time); NaN where it is unknown.
        warnings: Reasons to doubt it.
        severity: How severe its failures are, in words; empty without vehicles on lanes.
        decisive: What is left of the most typical failure's noise, in words; empty if it was not shrunk.
        lost: When that drive was lost, in words, likewise.
    """

    text: str
    probability: float
    interval: Interval
    share: float
    members: tuple[int, ...]
    ancestors: int
    representative: int
    time: float
    warnings: tuple[str, ...] = ()
    severity: str = ""
    decisive: str = ""
    lost: str = ""


@dataclass(frozen=True, repr=False)
class Kinds(Answer, Sequence[Kind]):
    """Kinds of failure of one specification, the likeliest first.

    Attributes:
        result: The estimate that they divide.
        kinds: The kinds; their probabilities add up to that of the estimate.
        points: (F, 2) failures along the first two principal components, for a picture.
        labels: (F,) kind of each kept failure.
    """

    result: Result
    kinds: tuple[Kind, ...]
    points: Floats
    labels: NDArray[np.int64]

    def __getitem__(self, index: int) -> Kind:  # type: ignore[override]
        return self.kinds[index]

    def __len__(self) -> int:
        return len(self.kinds)

    def table(self) -> Records:
        """Return one row for each kind."""
        return Records(
            {
                "kind": number,
                "probability": kind.probability,
                "low": kind.interval[0],
                "high": kind.interval[1],
                "share": kind.share,
                "failures": len(kind.members),
                "representative": kind.representative,
                "text": kind.text,
                "warnings": kind.warnings,
                "severity": kind.severity,
                "decisive": kind.decisive,
                "lost": kind.lost,
            }
            for number, kind in enumerate(self.kinds, 1)
        )

    def lines(self) -> list[str]:
        """Return the kinds in words."""
        count = len(self.kinds)
        total = format_estimate(self.result.probability, self.result.interval)
        head = f"{self.result.specification}: {count} kind{'s' * (count > 1)} of failure, together {total}"
        return [
            head,
            *(line for number, kind in enumerate(self.kinds, 1) for line in _describe(number, kind)),
        ]


def _describe(number: int, kind: Kind) -> list[str]:
    part = format_estimate(kind.probability, kind.interval)
    share = f"{describe_share(kind.share)} of failures"
    line = f"{number}: {part}, {share}: {kind.text}; see failure {kind.representative}"
    told = [f"   {kind.severity}"] if kind.severity else []
    told += [f"   failure {kind.representative} needs only: {kind.decisive}"] if kind.decisive else []
    told += [f"   {kind.lost}"] if kind.lost else []
    return [line, *told, *(f"   warning: {text}" for text in kind.warnings)]


def find_kinds(result: Result, max_kinds: int = 6, method: str = "kmeans") -> Kinds:
    """Sort the failures of a result into kinds.

    Args:
        result: Estimate whose failures they are; its rollouts are replayed.
        max_kinds: Largest number of kinds.
        method: "kmeans" or "hdbscan" (needs scikit-learn).

    Raises:
        UsageError: The method is unknown or not installed, or the failures do not fail again.
    """
    problem, sample = result.require_origin().problem, FailureSample.of(result)
    if method not in METHODS:
        raise UsageError(f"unknown method {method!r}", f"one of: {', '.join(METHODS)}")
    rollouts = replay_tapes(problem, sample.failures.noise)
    broken = sum(rollout.outcome == "error" for rollout in rollouts)
    if broken:
        text = f"{broken} of {sample.size} failures of {problem.names[0]} end with an error when replayed"
        raise UsageError(text, "the system has changed, or does not depend on its noise alone")
    causes = [find_first_violation(problem, rollout) for rollout in rollouts]
    features = _make_features(problem, rollouts, causes)
    components = _compute_components(features)
    labels = _sort(features, components, causes, max_kinds, method)
    shares = np.bincount(labels, sample.shares)
    labels = np.argsort(np.argsort(-shares, kind="stable"), kind="stable")[labels]
    kinds = [_make_kind(problem, sample, labels == k, features, causes) for k in range(len(shares))]
    return Kinds(result, tuple(kinds), components[:, :2], labels)


def _make_features(
    problem: Problem, rollouts: Sequence[ReplayedRollout], causes: Sequence[FirstViolation]
) -> Floats:
    # (F, D): each signal in units of its own spread over failures and time, then the cause, as if each
    # were one more signal.
    tables = np.stack([_tabulate(rollout, problem.steps + 1) for rollout in rollouts])
    finite = np.isfinite(tables)
    top = np.abs(np.where(finite, tables, 0.0)).max(axis=(0, 1), initial=0.0)
    tables = np.where(finite, tables, np.where(np.isnan(tables), 0.0, np.sign(tables) * top))
    spread = tables.std(axis=(0, 1))
    tables = tables / np.where(spread > 0.0, spread, 1.0)
    signals = tables.reshape(len(tables), -1) / math.sqrt(max(tables.shape[1], 1))
    texts = sorted({cause.key for cause in causes})
    which = np.array([[cause.key == text for text in texts] for cause in causes], dtype=float)
    when = np.array([cause.sample for cause in causes], dtype=float)[:, None] / max(problem.steps, 1)
    return np.concatenate([signals, which, when], axis=1)


def _tabulate(rollout: ReplayedRollout, samples: int) -> Floats:
    # Signals (samples, K); those of a drive that has ended stay what they were.
    table = tabulate_signals(rollout.signals)[1]
    return np.pad(table, ((0, samples - len(table)), (0, 0)), mode="edge")


def _compute_components(features: Floats) -> Floats:
    # (F, _COMPONENTS) coordinates along the largest principal components; zeros where there are fewer.
    left, sizes, _ = np.linalg.svd(features - features.mean(axis=0), full_matrices=False)
    components = (left * sizes)[:, :_COMPONENTS]
    return np.pad(components, ((0, 0), (0, _COMPONENTS - components.shape[1])))


def _sort(
    features: Floats, components: Floats, causes: Sequence[FirstViolation], max_kinds: int, method: str
) -> NDArray[np.int64]:
    if method == "kmeans" or len(features) < 3:
        return _merge_alike(find_clusters(components, max_kinds), features, causes)
    try:
        from sklearn.cluster import HDBSCAN
    except ImportError:
        raise UsageError("hdbscan needs scikit-learn", "pip install 'avrare[kinds]'") from None
    least = max(3, round(_LEAST_SHARE * len(features)))
    labels = np.asarray(HDBSCAN(min_cluster_size=least, copy=True).fit_predict(features))
    labels = np.where(labels < 0, labels.max() + 1, labels)  # those of no cluster are a kind of their own
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def _merge_alike(
    labels: NDArray[np.int64], features: Floats, causes: Sequence[FirstViolation]
) -> NDArray[np.int64]:
    # Clusters that are violated first in the same way and not clearly apart are one kind: k-means also cuts
    # what is one heap.
    labels = labels.copy()
    while True:
        keys = {
            k: Counter(causes[row].key for row in np.flatnonzero(labels == k).tolist())
            for k in np.unique(labels).tolist()
        }
        first = {k: found.most_common(1)[0][0] for k, found in keys.items()}
        pairs = [(j, k) for j, k in combinations(keys, 2) if first[j] == first[k]]
        gaps = [_measure_separation(features[labels == j], features[labels == k]) for j, k in pairs]
        if not gaps or min(gaps) >= _APART:
            return np.unique(labels, return_inverse=True)[1].reshape(-1)
        j, k = pairs[int(np.argmin(gaps))]
        labels[labels == k] = j


def _measure_separation(one: Floats, other: Floats) -> float:
    # Distance of the means in standard deviations along the line between them (Ashman, Bird and Zepf 1994);
    # 0 for a few outliers.
    if min(len(one), len(other)) <= _STRAY:
        return 0.0
    line = one.mean(axis=0) - other.mean(axis=0)
    distance = float(np.linalg.norm(line))
    variances = [float(np.var(part @ line, ddof=1)) / max(distance, 1e-300) ** 2 for part in (one, other)]
    pooled = math.sqrt(sum(variances) / 2.0)
    return distance / pooled if pooled > 0.0 else math.inf


def _make_kind(
    problem: Problem, sample: FailureSample, chosen: Bools, features: Floats, causes: Sequence[FirstViolation]
) -> Kind:
    rows = np.flatnonzero(chosen)
    distances = np.linalg.norm(features[rows][:, None] - features[rows][None], axis=2).sum(axis=1)
    medoid = int(rows[np.argmin(distances)])
    probability, interval = sample.part_interval(chosen)
    ancestors = sample.count_ancestors(chosen)
    warnings = []
    if ancestors == 1:
        first = "failure" if sample.failures.ancestors is None else "first rollout"
        warnings.append(f"it rests on one {first}: it may be much likelier, or rarer, than this")
    elif ancestors < _FEW:
        warnings.append(f"it rests on {ancestors} independent failures")
    samples = [causes[k].sample for k in rows.tolist() if causes[k].sample >= 0]
    dt = problem.dt
    time = float(np.median(samples)) * (dt or 1.0) if samples else math.nan
    parts = [_describe_causes([causes[k] for k in rows.tolist()], time, "s" if dt else "steps")]
    parts += describe_noise(problem, sample, chosen)
    return Kind(
        "; ".join(parts),
        probability,
        interval,
        float(sample.shares[chosen].sum()),
        tuple(rows.tolist()),
        ancestors,
        medoid,
        time,
        tuple(warnings),
        describe_severities([found for k in rows.tolist() if (found := causes[k].severity) is not None]),
    )


def _describe_causes(causes: Sequence[FirstViolation], time: float, unit: str) -> str:
    [(key, count)] = Counter(cause.key for cause in causes).most_common(1)
    often = "" if count == len(causes) else f" (in {count} of {len(causes)})"
    text = f"{key} is violated first{often}" if key else "the specification is violated"
    if math.isnan(time):
        return text
    digits = 0 if unit == "steps" else 1
    return f"{text}, at about {f't = {time:.{digits}f} s' if unit == 's' else f'step {time:.0f}'}"


def describe_noise(problem: Problem, sample: FailureSample, chosen: Bools) -> list[str]:
    """Describe the noise that sets some failures apart from chance, channel by channel and in time windows.

    Squares and sums of standard normal numbers are compared with what chance gives, to which copies of one
    ancestor, or failures of one run of splitting, count as one.
    """
    rows = np.flatnonzero(chosen)
    noise, shares = sample.failures.noise[rows], sample.shares[rows] / sample.shares[rows].sum()
    families = np.unique(sample.clusters[rows], return_inverse=True)[1].reshape(-1)
    effective = 1.0 / float((np.bincount(families, shares) ** 2).sum())
    windows = np.array_split(np.arange(noise.shape[1]), min(_WINDOWS, noise.shape[1]))
    names = find_noise_names(problem.system)
    dt = problem.dt
    found = []
    for window in windows:
        part = noise[:, window]
        mean = np.einsum("f,fwc->c", shares, part) / len(window)
        square = np.einsum("f,fwc->c", shares, part**2) / len(window)
        count = effective * len(window)
        shift, size = mean * math.sqrt(count), (square - 1.0) * math.sqrt(count / 2.0)
        begin, end = int(window[0]), int(window[-1])
        for channel in range(noise.shape[2]):
            when = _format_window(begin, end, dt)
            one_sided = mean[channel] ** 2 >= _ONE_SIDED * square[channel]
            if one_sided and abs(shift[channel]) >= _TELLING:
                text = f"{names[channel]} {mean[channel]:+.2g} sigma on average {when}"
                found.append((abs(float(shift[channel])), text))
            elif size[channel] >= _TELLING:
                text = f"{names[channel]} {math.sqrt(square[channel]):.2g} times as large as usual {when}"
                found.append((float(size[channel]), text))
    return [text for _, text in sorted(found, reverse=True)[:_NAMED]]


def _format_window(begin: int, end: int, dt: float | None) -> str:
    if dt is None:
        return f"at step {begin}" if begin == end else f"in steps {begin}-{end}"
    return f"at t = {begin * dt:.1f} s" if begin == end else f"at t = {begin * dt:.1f}-{end * dt:.1f} s"
