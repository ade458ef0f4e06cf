"""Report of the study: a row for each problem, and one for all."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Sequence
from statistics import mean, median

from .study import Outcome

COLUMNS = {
    "problem": "",
    "p": "exact probability",
    "n": "results",
    "med/p": "median of the estimates over p",
    "quiet": "results without a warning",
    "covers": "share of these whose interval covers p [%]",
    "warned": "share of the results with a warning [%]",
    "w covers": "share of these whose interval covers p [%]",
    "CW": "confidently wrong: no warning, and the interval misses p by more than a factor of three",
    "WN": "warned but narrow: a warning, and the interval misses p by more than a factor of three",
    "w hi/lo": "median ratio of the ends of the intervals with a warning",
    "work": "mean of cost times squared error, over that of Monte Carlo",
    "cost": "largest cost: over the budget, else in complete rollouts",
}


def print_report(estimator: str, outcomes: Sequence[Outcome], hidden: Collection[str] = ()) -> None:
    """Print the table of an estimator; problems of hidden combinations have a star."""
    groups: dict[str, list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        groups[outcome.task.problem].append(outcome)
    names = {name: name + " *" * (name in hidden) for name in groups}
    rows = [list(COLUMNS), *([names[name], *summarise(group)] for name, group in sorted(groups.items()))]
    if outcomes:
        total = summarise(outcomes)
        rows.append(["all", "", *total[1:-2], "", total[-1]])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    print(f"{estimator}: {len(outcomes)} results")
    for row in rows:
        print("  ".join(entry.ljust(width) for entry, width in zip(row, widths, strict=True)).rstrip())
    print("\n* hidden combination")
    print("\n".join(f"{name}: {text}" for name, text in COLUMNS.items() if text))


def summarise(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the entries of the results of a problem, without its name."""
    truth = outcomes[0].truth
    quiet = [outcome for outcome in outcomes if not outcome.warnings]
    warned = [outcome for outcome in outcomes if outcome.warnings]
    ratios = [outcome.high / outcome.low if outcome.low > 0 else float("inf") for outcome in warned]
    work = mean(outcome.cost * (outcome.probability - truth) ** 2 for outcome in outcomes)
    used = [outcome.used for outcome in outcomes if outcome.used is not None]
    return [
        f"{truth:.1e}",
        str(len(outcomes)),
        f"{median(outcome.probability / outcome.truth for outcome in outcomes):.2f}",
        str(len(quiet)),
        _percent([outcome.covers for outcome in quiet]),
        _percent([bool(outcome.warnings) for outcome in outcomes]),
        _percent([outcome.covers for outcome in warned]),
        str(sum(outcome.misses for outcome in quiet)),
        str(sum(outcome.misses for outcome in warned)),
        f"{median(ratios):.3g}" if ratios else "",
        f"{work / (truth * (1 - truth)):.3f}",
        f"{max(used):.2f}" if used else f"{max(outcome.cost for outcome in outcomes):,.0f}",
    ]


def _percent(hits: Sequence[bool]) -> str:
    return f"{100 * mean(hits):.0f}" if hits else ""
