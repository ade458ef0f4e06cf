"""Reports of a study: a row for each problem, the goals over all, and what is still to run."""

from __future__ import annotations

import csv
import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import mean, median, stdev

import numpy as np
from scipy.stats import binom

from .study import Outcome, Task

CONFIDENCE = 0.95
LEAST_QUIET = 50
"""Results without a warning from which the coverage of a problem is judged."""
LEAST_RESULTS = 10
"""Results from which the mean and the work of a problem are judged."""
LEAST_PROBABILITY = 5e-5
"""Probability from which a warned interval must have ends that are not too far apart."""
SMALL_PROBABILITY = 1e-4
RESAMPLES = 2000
COLUMNS = {
    "problem": "",
    "p": "known probability",
    "n": "results",
    "chosen": "estimators, with the results of each",
    "mean/p": "mean of the estimates over p",
    "z": "its distance from 1 in standard errors",
    "med/p": "median of the estimates over p",
    "quiet": "results without a warning",
    "covers": "share of these whose interval covers p [%]",
    "least": "0.1 % quantile of that share at a coverage of 95 % [%]",
    "warned": "share of the results with a warning [%]",
    "w covers": "share of these whose interval covers p [%]",
    "CW": "confidently wrong: no warning, and the interval misses p by more than a factor of three",
    "WN": "warned but narrow: a warning, and the interval misses p by more than a factor of three",
    "w hi/lo": "median ratio of the ends of the intervals with a warning",
    "work": "mean of cost times squared error, over that of Monte Carlo",
    "work <": "upper end of its 95 % bootstrap interval",
    "passes": "share of the results with which a threshold at exactly p passes [%]",
    "cost": "largest cost: over the budget, else in complete rollouts",
    "seconds": "mean CPU time [s]",
}


def print_report(estimator: str, outcomes: Sequence[Outcome], hidden: Collection[str] = ()) -> None:
    """Print the table of an estimator and what it says of the goals; hidden combinations have a star."""
    groups = _group(outcomes)
    names = {name: name + " *" * (name in hidden) for name in groups}
    print(f"{estimator}: {len(outcomes)} results")
    _print_rows([list(COLUMNS), *([names[name], *summarise(groups[name])] for name in sorted(groups))])
    print("\n* hidden combination")
    print("\n".join(f"{name}: {text}" for name, text in COLUMNS.items() if text))
    if outcomes:
        print()
        _print_rows([["goal", "limit", "measured"], *list_goals(outcomes, hidden)])


def write_summary(file: Path, outcomes: Sequence[Outcome]) -> None:
    """Write a row for each estimator, its budget, options and code, and problem, as CSV."""
    groups: dict[tuple[str, ...], list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        task = outcome.task
        groups[task.estimator, task.budget, task.options, task.digest, task.problem].append(outcome)
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("w", encoding="utf-8", newline="") as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["estimator", "budget", "options", "code", *COLUMNS])
        writer.writerows([*key, *summarise(group)] for key, group in sorted(groups.items()))


def summarise(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the entries of the results of a problem, without its name."""
    truth = outcomes[0].truth
    quiet = [outcome for outcome in outcomes if not outcome.warnings]
    warned = [outcome for outcome in outcomes if outcome.warnings]
    ratios = [outcome.ratio for outcome in outcomes]
    work, most = measure_work(outcomes)
    chosen = Counter(outcome.chosen for outcome in outcomes)
    used = [outcome.used for outcome in outcomes if outcome.used is not None]
    return [
        f"{truth:.1e}",
        str(len(outcomes)),
        " ".join(f"{name} {number}" for name, number in chosen.items() if name),
        f"{mean(ratios):.3f}",
        _z(ratios),
        f"{median(ratios):.2f}",
        str(len(quiet)),
        _percent([outcome.covers for outcome in quiet]),
        f"{100 * _least_share(len(quiet)):.0f}" if quiet else "",
        _percent([bool(outcome.warnings) for outcome in outcomes]),
        _percent([outcome.covers for outcome in warned]),
        str(sum(outcome.misses for outcome in quiet)),
        str(sum(outcome.misses for outcome in warned)),
        _median([outcome.end_ratio for outcome in warned]),
        f"{work:.3f}",
        f"{most:.3f}",
        _percent([outcome.passes for outcome in outcomes]),
        f"{max(used):.2f}" if used else f"{max(outcome.cost for outcome in outcomes):,.0f}",
        f"{mean(outcome.seconds for outcome in outcomes):.2f}",
    ]


def list_goals(outcomes: Sequence[Outcome], hidden: Collection[str] = ()) -> list[list[str]]:
    """Return the goals of the intervals: each with its limit and what was measured."""
    groups = _group(outcomes)
    judged = {name: group for name, group in groups.items() if len(group) >= LEAST_RESULTS}
    quiet = [outcome for outcome in outcomes if not outcome.warnings]
    warned = [outcome for outcome in outcomes if outcome.warnings]
    combined = [outcome for outcome in outcomes if outcome.task.problem in hidden]
    plain = [outcome for outcome in outcomes if outcome.task.problem not in hidden]
    frequent = [outcome for outcome in warned if outcome.truth >= LEAST_PROBABILITY]
    works = {name: measure_work(group) for name, group in judged.items()}
    rare = [works[name][0] for name, group in judged.items() if group[0].truth < SMALL_PROBABILITY]
    trusted = [[outcome.ratio for outcome in group if not outcome.warnings] for group in judged.values()]
    scores = filter(None, (_z(ratios) for ratios in trusted if len(ratios) >= LEAST_RESULTS))
    low = [f"{name} {sum(hits)}/{len(hits)}" for name, hits in _hits(groups) if _covers_too_little(hits)]
    dear = [f"{name} {work:.2f} (<= {most:.2f})" for name, (work, most) in works.items() if most > 1.5]
    passes = [outcome for outcome in combined if outcome.verdict == "pass" and not outcome.covers]
    return [
        ["largest |z| of an unwarned mean", "<= 3.5", _largest(abs(float(score)) for score in scores)],
        ["problems whose quiet coverage is too low", "none", ", ".join(low) or "none"],
        ["coverage without a warning [%]", ">= 94.5", _percent([outcome.covers for outcome in quiet], 1)],
        ["confidently wrong", "<= 1 in 1,000", _share([outcome.misleads for outcome in plain])],
        ["of hidden combinations", "<= 1 in 20", _share([outcome.misleads for outcome in combined])],
        ["of these a pass", "none", str(len(passes))],
        ["warned [%]", "<= 15", _percent([bool(outcome.warnings) for outcome in outcomes], 1)],
        ["warned and narrow", "none", _share([outcome.misses for outcome in warned])],
        [
            f"ends of warned intervals, p >= {LEAST_PROBABILITY:g}",
            "<= 100",
            _median([outcome.end_ratio for outcome in frequent]),
        ],
        ["work over Monte Carlo's, each problem", "<= 1.5", ", ".join(dear) or f"all of {len(works)}"],
        [f"work, median of p < {SMALL_PROBABILITY:g}", "<= 0.3", _median(rare)],
        ["passes of a threshold at p [%]", "<= 3.6", _percent([outcome.passes for outcome in outcomes], 1)],
        ["largest cost over the budget", "<= 1.1", _largest(outcome.used for outcome in outcomes)],
    ]


def measure_work(outcomes: Sequence[Outcome]) -> tuple[float, float]:
    """Return mean cost times squared error over Monte Carlo's, and its upper 95 % bound by bootstrap."""
    truth = outcomes[0].truth
    values = np.array([outcome.cost * (outcome.probability - truth) ** 2 for outcome in outcomes])
    values /= truth * (1.0 - truth)
    rows = np.random.default_rng(0).integers(0, len(values), (RESAMPLES, len(values)))
    return float(values.mean()), float(np.quantile(values[rows].mean(axis=1), 0.975))


def print_forecast(tasks: Iterable[Task], outcomes: Iterable[Outcome]) -> None:
    """Print the CPU hours that tasks will take, by those of the same problem that have been run."""
    seconds: dict[tuple[str, str], list[float]] = defaultdict(list)
    for outcome in outcomes:
        seconds[outcome.task.estimator, outcome.task.problem].append(outcome.seconds)
    cells: dict[tuple[str, str], int] = defaultdict(int)
    for task in tasks:
        cells[task.estimator, task.problem] += 1
    rows = [["estimator", "problem", "missing", "seconds each", "hours"]]
    totals: dict[str, float] = defaultdict(float)
    for cell, missing in sorted(cells.items()):
        each = mean(seconds[cell]) if seconds[cell] else math.nan
        totals[cell[0]] += 0.0 if math.isnan(each) else missing * each / 3600
        rows.append([*cell, str(missing), f"{each:.1f}", f"{missing * each / 3600:.2f}"])
    rows += [[name, "all that are timed", "", "", f"{hours:.1f}"] for name, hours in totals.items()]
    _print_rows(rows)


def _group(outcomes: Iterable[Outcome]) -> Mapping[str, list[Outcome]]:
    groups: dict[str, list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        groups[outcome.task.problem].append(outcome)
    return groups


def _least_share(results: int) -> float:
    return float(binom.ppf(0.001, results, CONFIDENCE)) / results


def _hits(groups: Mapping[str, Sequence[Outcome]]) -> Iterator[tuple[str, list[bool]]]:
    """Yield whether each interval without a warning covers, by problem."""
    for name, group in sorted(groups.items()):
        yield name, [outcome.covers for outcome in group if not outcome.warnings]


def _covers_too_little(hits: Sequence[bool]) -> bool:
    return len(hits) >= LEAST_QUIET and mean(hits) < _least_share(len(hits))


def _z(ratios: Sequence[float]) -> str:
    error = stdev(ratios) / len(ratios) ** 0.5 if len(ratios) > 1 else 0.0
    return f"{(mean(ratios) - 1) / error:.1f}" if error else ""


def _percent(hits: Sequence[bool], digits: int = 0) -> str:
    return f"{100 * mean(hits):.{digits}f}" if hits else ""


def _share(hits: Sequence[bool]) -> str:
    return f"{sum(hits)} of {len(hits):,}"


def _median(values: Sequence[float]) -> str:
    return f"{median(values):.3g}" if values else ""


def _largest(values: Iterable[float | None]) -> str:
    return f"{max(used):.2f}" if (used := [value for value in values if value is not None]) else ""


def _print_rows(rows: Sequence[Sequence[str]]) -> None:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(entry.ljust(width) for entry, width in zip(row, widths, strict=True)).rstrip())
