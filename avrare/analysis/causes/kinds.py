"""Kinds of failure: clusters of failing rollouts that go alike, each with its own probability.

Failures are clustered by their signals over time, by the comparison that is violated first, and by when. A
kind is described by that and by the noise that sets it apart from chance. The probabilities of the kinds add
up to the estimate; their intervals take the kinds as given.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
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
from avrare.rollout.noise_words import find_common_noise, format_time, join_disturbances
from avrare.rollout.problem import Problem
from avrare.rollout.replay import ReplayedRollout, replay_tapes, tabulate_signals

METHODS = ("kmeans", "hdbscan")


@dataclass(frozen=True)
class Kind:
    """Kind of failure.

    Attributes:
        text: What happens, and when.
        cause: Noise that goes with it, on average; empty where none differs from chance.
        probability: Probability of a failure of this kind.
        interval: Its interval.
        share: Share of all failures.
        members: Indices of the kept failures.
        ancestors: Number of first ancestors of these.
        representative: Index of the most typical one: the medoid.
        time: Median time of the first violation [s] (steps without a time step); NaN where it is unknown.
        warnings: Reasons to doubt it.
        severity: Description of how severe its failures are; empty without vehicles on lanes.
        decisive: Description of the shrunk noise of the most typical failure; empty if it was not shrunk.
        lost: Description of the moment at which that drive was lost, likewise.
    """

    text: str
    cause: str
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
    """Kinds of failure of one specification, by falling probability.

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
                "cause": kind.cause,
                "warnings": kind.warnings,
                "severity": kind.severity,
                "decisive": kind.decisive,
                "lost": kind.lost,
            }
            for number, kind in enumerate(self.kinds, 1)
        )

    def lines(self) -> list[str]:
        """Describe the kinds."""
        count, kept, failures = len(self.kinds), len(self.labels), self.result.failures.count
        total = format_estimate(self.result.probability, self.result.interval)
        head = f"{self.result.specification}: {count} kind{'s' * (count > 1)} of failure, together {total}"
        head += f", by the {kept:,} of {failures:,} failures that are kept" if kept < failures else ""
        return [
            head,
            *(line for number, kind in enumerate(self.kinds, 1) for line in _list_lines(number, kind)),
        ]


def _list_lines(number: int, kind: Kind) -> list[str]:
    part = format_estimate(kind.probability, kind.interval)
    share = f"{describe_share(kind.share)} of failures"
    line = f"{number}: {part}, {share}: {kind.text}; see failure {kind.representative}"
    details = [f"   cause, on average: {kind.cause}"] if kind.cause else []
    details += [f"   {kind.severity}"] if kind.severity else []
    details += [f"   failure {kind.representative} needs only: {kind.decisive}"] if kind.decisive else []
    details += [f"   {kind.lost}"] if kind.lost else []
    return [line, *details, *(f"   warning: {text}" for text in kind.warnings)]


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
    failing = _Failing(problem, sample, rollouts, causes)
    features = failing.features
    components = _compute_components(features)
    labels = _sort(features, components, causes, max_kinds, method)
    shares = np.bincount(labels, sample.shares)
    labels = np.argsort(np.argsort(-shares, kind="stable"), kind="stable")[labels]
    kinds = [_make_kind(failing, labels, k) for k in range(len(shares))]
    return Kinds(result, tuple(kinds), components[:, :2], labels)


@dataclass(frozen=True)
class _Failing:
    """The F failures, replayed, each with its first violation."""

    problem: Problem
    sample: FailureSample
    rollouts: Sequence[ReplayedRollout]
    causes: Sequence[FirstViolation]

    @cached_property
    def tables(self) -> Floats:
        """(F, steps + 1, K) signals; those of a drive that has ended stay what they were."""
        samples = self.problem.steps + 1
        tables = (tabulate_signals(rollout.signals)[1] for rollout in self.rollouts)
        padded = [np.pad(table, ((0, samples - len(table)), (0, 0)), mode="edge") for table in tables]
        stacked = np.stack(padded)
        finite = np.isfinite(stacked)
        top = np.abs(np.where(finite, stacked, 0.0)).max(axis=(0, 1), initial=0.0)
        return np.where(finite, stacked, np.where(np.isnan(stacked), 0.0, np.sign(stacked) * top))

    @cached_property
    def features(self) -> Floats:
        """(F, D) signals in units of their spread over failures and time, then the cause."""
        spread = self.tables.std(axis=(0, 1))
        tables = self.tables / np.where(spread > 0.0, spread, 1.0)
        signals = tables.reshape(len(tables), -1) / math.sqrt(max(tables.shape[1], 1))
        texts = sorted({cause.key for cause in self.causes})
        which = np.array([[cause.key == text for text in texts] for cause in self.causes], dtype=float)
        when = np.array([cause.sample for cause in self.causes], dtype=float)[:, None]
        return np.concatenate([signals, which, when / max(self.problem.steps, 1)], axis=1)

    def find_key(self, chosen: Bools) -> tuple[str, int]:
        """Return the most frequent first violation of some failures, and its count."""
        keys = Counter(self.causes[row].key for row in np.flatnonzero(chosen).tolist())
        return keys.most_common(1)[0]


def _compute_components(features: Floats) -> Floats:
    # Coordinates (F, components) along the largest components; zeros where there are fewer.
    left, sizes, _ = np.linalg.svd(features - features.mean(axis=0), full_matrices=False)
    most_components = 5  # principal components of the features in which k-means makes clusters
    components = (left * sizes)[:, :most_components]
    return np.pad(components, ((0, 0), (0, most_components - components.shape[1])))


def _sort(
    features: Floats, components: Floats, causes: Sequence[FirstViolation], max_kinds: int, method: str
) -> NDArray[np.int64]:
    if method == "kmeans" or len(features) < 3:
        return _merge_alike(find_clusters(components, max_kinds), features, causes)
    try:
        from sklearn.cluster import HDBSCAN
    except ImportError:
        raise UsageError("hdbscan needs scikit-learn", "pip install 'avrare[kinds]'") from None
    least_share = 0.05  # least share of failures for which HDBSCAN makes a kind
    least = max(3, round(least_share * len(features)))
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
        first = {k: counts.most_common(1)[0][0] for k, counts in keys.items()}
        pairs = [(j, k) for j, k in combinations(keys, 2) if first[j] == first[k]]
        gaps = [_measure_separation(features[labels == j], features[labels == k]) for j, k in pairs]
        # least separation of two kinds; a uniform law cut in the middle has 3.5, a normal one 2.7
        least_separation = 4.0
        if not gaps or min(gaps) >= least_separation:
            return np.unique(labels, return_inverse=True)[1].reshape(-1)
        j, k = pairs[int(np.argmin(gaps))]
        labels[labels == k] = j


def _measure_separation(first: Floats, second: Floats) -> float:
    # Distance of the means in standard deviations along the line between them (Ashman, Bird and Zepf 1994);
    # 0 for a few outliers.
    most_stray = 4  # so few failures do not make a kind, unless they begin with another violation
    if min(len(first), len(second)) <= most_stray:
        return 0.0
    line = first.mean(axis=0) - second.mean(axis=0)
    distance = float(np.linalg.norm(line))
    variances = [float(np.var(part @ line, ddof=1)) / max(distance, 1e-300) ** 2 for part in (first, second)]
    pooled = math.sqrt(sum(variances) / 2.0)
    return distance / pooled if pooled > 0.0 else math.inf


def _make_kind(failing: _Failing, labels: NDArray[np.int64], number: int) -> Kind:
    sample, causes, chosen = failing.sample, failing.causes, labels == number
    rows = np.flatnonzero(chosen)
    features = failing.features[rows]
    distances = np.linalg.norm(features[:, None] - features[None], axis=2).sum(axis=1)
    probability, interval = sample.part_interval(chosen)
    ancestors = sample.count_ancestors(chosen)
    warnings = []
    if ancestors == 1:
        first = "failure" if sample.failures.ancestors is None else "first rollout"
        warnings.append(f"it rests on one {first}: it may be much likelier, or rarer, than this")
    elif ancestors < 5:  # a kind of few failures
        warnings.append(f"it rests on {ancestors} independent failures")
    samples = [causes[row].sample for row in rows.tolist() if causes[row].sample >= 0]
    severities = [causes[row].severity for row in rows.tolist()]
    return Kind(
        "; ".join(_describe(failing, labels, number, samples)),
        describe_cause(failing.problem, sample, chosen, failing.rollouts),
        probability,
        interval,
        float(sample.shares[chosen].sum()),
        tuple(rows.tolist()),
        ancestors,
        int(rows[np.argmin(distances)]),
        float(np.median(samples)) * (failing.problem.dt or 1.0) if samples else math.nan,
        tuple(warnings),
        describe_severities([severity for severity in severities if severity is not None]),
    )


def _describe(
    failing: _Failing, labels: NDArray[np.int64], number: int, samples: Sequence[int]
) -> Iterator[str]:
    """Yield the first event with its time, and the difference from kinds that begin with the same event."""
    chosen, dt = labels == number, failing.problem.dt
    key, count = failing.find_key(chosen)
    often = "" if count == chosen.sum() else f" (in {count} of {chosen.sum()})"
    when = f", at about {format_time(round(np.median(samples)), dt)}" if samples else ""
    yield f"{key} is violated first{often}{when}" if key else f"the specification is violated{when}"
    others = [k for k in np.unique(labels).tolist() if k != number]
    similar = [k for k in others if failing.find_key(labels == k)[0] == key]
    if similar:
        last = round(np.median(samples)) if samples else failing.problem.steps
        where = "the other kind" if len(similar) == 1 else "the others"
        yield _tell_apart(failing, chosen, np.isin(labels, similar), last, where)


def _tell_apart(failing: _Failing, chosen: Bools, others: Bools, last: int, where: str) -> str:
    """Describe the signal, up to a sample, in which some failures differ most clearly from others."""
    tables = failing.tables[:, : last + 1]
    spread = np.sqrt(0.5 * (tables[chosen].var(axis=0) + tables[others].var(axis=0)))
    means = tables[chosen].mean(axis=0), tables[others].mean(axis=0)
    floor = 1e-3 * tables.std(axis=(0, 1)) + 1e-300
    step, column = np.unravel_index(np.argmax(np.abs(means[0] - means[1]) / (spread + floor)), spread.shape)
    name = tabulate_signals(failing.rollouts[0].signals, failing.problem.scene)[0][column]
    here, there = (float(mean[step, column]) for mean in means)
    digits = next((digits for digits in range(3, 17) if f"{here:.{digits}g}" != f"{there:.{digits}g}"), 17)
    time = format_time(int(step), failing.problem.dt)
    return f"{name} is {here:.{digits}g} at {time} ({there:.{digits}g} in {where})"


def describe_cause(
    problem: Problem, sample: FailureSample, chosen: Bools, rollouts: Sequence[ReplayedRollout]
) -> str:
    """Describe the noise that sets some failures apart from chance; empty if there is none.

    Copies of one ancestor, or failures of one run of splitting, count as one.
    """
    rows = np.flatnonzero(chosen)
    shares = sample.shares[rows] / sample.shares[rows].sum()
    families = np.unique(sample.clusters[rows], return_inverse=True)[1].reshape(-1)
    effective = 1.0 / float((np.bincount(families, shares) ** 2).sum())
    tapes = sample.failures.noise[rows]
    noise = find_common_noise(problem, tapes, [rollouts[row] for row in rows.tolist()], shares, effective)
    return join_disturbances(noise) if noise else ""
