"""docs/estimators.md from the blocks that there are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from avrare.testing.problems import reference_problem, reference_problems
from studies import cells, peers
from studies.run_intervals import interval_of_runs

RESOLVABLE = 0.05
"""Relative standard error of a mean up to which a z-test makes sense."""


_PAGE = """# Estimators on problems with exact answers

`OMP_NUM_THREADS=1 python benchmarks/estimators.py` makes this page from independent runs of splitting, `ams`.
`avrare.testing` defines the problems and gives their exact probabilities ([testing](testing.md)).

## Bias

The table shows the mean of the runs over the truth with its standard error, z, the share of extinct runs
(they count as 0), and the relative mean squared error times the cost in whole rollouts, beside Monte
Carlo's (1 - p)/p. Where the standard error is above {resolvable}, the estimates are too skewed for a z-test
at that N, and z is not given.

{bias}

## Coverage

The table shows the share of {intervals:,} intervals (95 %, each of {runs} runs) that hold the truth, and on
which side of the truth the others lie. No interval is left out. The intervals are those of t delta-log;
since then Cox's is joined to them ([the interval](statistics.md#the-interval)), each end being the
farther one, and the runs have kept their bits: today's cover at least as often. Of one row 910 of
today's were made again: g_eventually_c0.5, N 500, covers .954.

{coverage}

## Beside OpenTURNS

Subset sampling of OpenTURNS (level probability {level}) is compared with splitting at about the same number
of evaluations, with {repetitions} repetitions of each. Splitting has ten runs, which is the default and
gives the interval, or one larger run. The ratio of relative mean squared error times cost has a bootstrap
interval.

{peers}
"""


def report(results: Path) -> str:
    """Return the page."""
    return _PAGE.format(
        resolvable=RESOLVABLE, intervals=cells.INTERVALS, runs=cells.RUNS_OF_INTERVAL,
        level=peers.LEVEL_PROBABILITY, repetitions=peers.REPETITIONS, bias="\n".join(_bias(results)),
        coverage="\n".join(_coverage(results)), peers="\n".join(_peers(results)),
    )  # fmt: skip


def _load(results: Path, cell: str) -> dict[str, np.ndarray] | None:
    files = sorted(results.glob(f"{cell}-[0-9][0-9][0-9].npz"))
    loaded = [dict(np.load(file)) for file in files]
    if not loaded:
        return None
    names = [name for name in loaded[0] if name != "relation"]
    return {name: np.concatenate([np.atleast_1d(block[name]) for block in loaded]) for name in names}


def _bias(results: Path) -> Iterator[str]:
    yield "| problem | p | N, K | runs | mean / p | z | extinct | MSE x cost | Monte Carlo's |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for reference in reference_problems():
        for particles, discard in cells.SETTINGS:
            data = _load(results, f"bias-{reference.id}-N{particles}-K{discard}")
            if data is not None:
                yield _bias_row(reference.id, particles, discard, data)


def _bias_row(name: str, particles: int, discard: int, data: dict[str, np.ndarray]) -> str:
    reference = reference_problem(name)
    truth, ratio = reference.probability, data["values"] / reference.probability
    error = ratio.std(ddof=1) / np.sqrt(len(ratio))
    z = f"{(ratio.mean() - 1) / error:+.1f}" if 0 < error <= RESOLVABLE else "not resolved"
    gain = ((ratio - 1) ** 2).mean() * data["steps"].sum() / max(reference.steps, 1) / len(ratio)
    mean = f"{ratio.mean():.3f} ± {error:.3f}"
    return (
        f"| {name} | {truth:.3g} | {particles}, {discard} | {len(ratio):,} | {mean} | {z} "
        f"| {(ratio == 0).mean():.1%} | {gain:,.0f} | {(1 - truth) / truth:,.0f} |"
    )


def _coverage(results: Path) -> Iterator[str]:
    yield "| problem | p | N, K | intervals | cover | below the truth | above it |"
    yield "|---|---|---|---|---|---|---|"
    for name in cells.COVERED:
        truth = reference_problem(name).probability
        for particles, discard in cells.COVERAGE_SETTINGS:
            data = _load(results, f"coverage-{name}-N{particles}-K{discard}")
            if data is None:
                continue
            groups = data["values"].reshape(-1, cells.RUNS_OF_INTERVAL)
            bounds = np.array([interval_of_runs(group, particles)(0.95) for group in groups])
            below, above = (bounds[:, 1] < truth).mean(), (bounds[:, 0] > truth).mean()
            yield (
                f"| {name} | {truth:.3g} | {particles}, {discard} | {len(groups):,} "
                f"| {1 - below - above:.3f} | {below:.3f} | {above:.3f} |"
            )


def _peers(results: Path) -> Iterator[str]:
    heads = "mean / p | cost | MSE x cost"
    yield f"| problem | splitting | {heads} | OpenTURNS: {heads} | ratio | goal |"
    yield "|---|---|---|---|---|---|---|---|---|---|"
    without = 0
    for name, goal in peers.PROBLEMS.items():
        theirs = _load(results, f"peers-openturns-{name}")
        if theirs is None:
            continue
        given = ~np.isnan(theirs["values"])
        without += int((~given).sum())
        theirs = {key: values[given] for key, values in theirs.items()}
        particles, truth = peers.PARTICLES[name], reference_problem(name).probability
        for method, words in (("ams", f"10 runs of {particles}"), ("ams-one", f"1 of {10 * particles:,}")):
            ours = _load(results, f"peers-{method}-{name}")
            if ours is None:
                continue
            low, high = _bootstrap(ours, theirs, truth)
            ratio = _gain(ours, truth) / _gain(theirs, truth)
            both = f"{_side(ours, truth)} | {_side(theirs, truth)}"
            yield f"| {name} | {words} | {both} | {ratio:.2f} ({low:.2f} to {high:.2f}) | {goal} |"
    times = "once" if without == 1 else f"{without} times"
    yield f"\nLeft out: OpenTURNS ended {times} with an error about its variance estimate."


def _side(data: dict[str, np.ndarray], truth: float) -> str:
    return f"{data['values'].mean() / truth:.3f} | {data['costs'].mean():,.0f} | {_gain(data, truth):,.0f}"


def _gain(data: dict[str, np.ndarray], truth: float, pick: np.ndarray | slice = slice(None)) -> float:
    return float(((data["values"][pick] / truth - 1) ** 2).mean() * data["costs"][pick].mean())


def _bootstrap(
    ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray], truth: float
) -> tuple[float, float]:
    rng = np.random.default_rng(0)

    def again(data: dict[str, np.ndarray]) -> float:
        many = len(data["values"])
        return _gain(data, truth, rng.integers(many, size=many))

    low, high = np.quantile([again(ours) / again(theirs) for _ in range(2000)], [0.025, 0.975])
    return float(low), float(high)
