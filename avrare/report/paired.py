"""Two versions on the same noise: the table, and the same as plain data."""

from __future__ import annotations

from typing import Any

from rich import box
from rich.table import Table

import avrare
from avrare.compare.paired import Paired, Pairs
from avrare.estimation.result import finite
from avrare.report.console import number
from avrare.scenario.fingerprint import fingerprint

SCHEMA = 1
FEW = 10
"""Rollouts that came out differently, below which there is little to go by."""


def headline(paired: Paired) -> str:
    """What was compared."""
    first, second = paired.names
    other = second if second != first else f"{second} with other settings"
    return f"{first} and then {other}: {paired.rollouts:,} rollouts each, on the same noise"


def table(paired: Paired) -> Table:
    """One row for each specification."""
    view = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, padding=(0, 1, 0, 0))
    view.add_column("specification", no_wrap=True)
    level = f"{paired.confidence:.0%} interval"
    for name in ("first", "second", "change", level, "mended", "newly failing", "p-value"):
        view.add_column(name, justify="right", no_wrap=True)
    view.add_column("", no_wrap=True)
    for pair in paired.pairs:
        low, high = pair.interval(paired.confidence)
        view.add_row(
            pair.specification, number(pair.first), number(pair.second), signed(pair.difference),
            f"{signed(low)} .. {signed(high)}", str(pair.only_first), str(pair.only_second),
            f"{pair.p_value:.2g}", _coloured(verdict(pair, paired.confidence)),
        )  # fmt: skip
    return view


def verdict(pair: Pairs, confidence: float) -> str:
    """The change in a word: worse, better, same (no rollout came out differently) or not known."""
    low, high = pair.interval(confidence)
    if low > 0.0:
        return "worse"
    if high < 0.0:
        return "better"
    return "not known" if pair.only_first + pair.only_second + pair.undecided else "same"


def brief(paired: Paired) -> list[str]:
    """A line for each specification: ``safe_distance: worse, +0.012 (+0.004 .. +0.02)``."""
    lines = []
    for pair in paired.pairs:
        low, high = pair.interval(paired.confidence)
        change = f"{signed(pair.difference)} ({signed(low)} .. {signed(high)})"
        lines.append(f"{pair.specification}: {verdict(pair, paired.confidence)}, {change}")
    return lines


def notes(paired: Paired) -> list[str]:
    """What to know when reading the table."""
    lines = []
    for pair in paired.pairs:
        differ = pair.only_first + pair.only_second
        if 0 < differ < FEW:
            few = f"{differ} rollout{'s' * (differ > 1)}"
            lines.append(f"{pair.specification}: only {few} came out differently; more rollouts tell more")
    broken = paired.pairs[0].undecided
    if broken:
        lines.append(
            f"{broken} of {paired.rollouts} rollouts broke down: the intervals allow for both outcomes"
        )
    return lines


def document(paired: Paired) -> dict[str, Any]:
    """All numbers, JSON-ready."""
    versions = {name: version for scenario in paired.scenarios for name, version in scenario.versions.items()}
    content = {
        "schema": SCHEMA,
        "first": paired.names[0],
        "second": paired.names[1],
        "fingerprints": [fingerprint(scenario) for scenario in paired.scenarios],
        "versions": dict(sorted({**versions, "avrare": avrare.__version__}.items())),
        "rollouts": paired.rollouts,
        "seed": paired.seed,
        "confidence": paired.confidence,
        "specifications": [_entry(pair, paired.confidence) for pair in paired.pairs],
    }
    return finite(content)  # type: ignore[no-any-return]


def signed(value: float) -> str:
    """A difference in a few digits, with its sign."""
    return f"{value:+.2g}" if value else "0"


def _entry(pair: Pairs, confidence: float) -> dict[str, Any]:
    return {
        "specification": pair.specification,
        "probability": [pair.first, pair.second],
        "difference": pair.difference,
        "interval": list(pair.interval(confidence)),
        "both": pair.both,
        "only_first": pair.only_first,
        "only_second": pair.only_second,
        "neither": pair.neither,
        "errors": pair.undecided,
        "p_value": pair.p_value,
        "verdict": verdict(pair, confidence),
    }


def _coloured(word: str) -> str:
    colours = {"worse": "red", "better": "green", "same": "green", "not known": "yellow"}
    return f"[{colours[word]}]{word}[/]"
