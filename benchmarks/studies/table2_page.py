"""The page of ``benchmarks/table2.py``: the paper's table with our truth, and what each row is worth."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from avrare.scenario.schema import Scenario

RULES = ("safe_distance", "no_abrupt_braking", "traffic_flow", "left_traffic")
METHODS = ("Raw-MC", "Imp-Naive", "Imp-CE", "STL-AMS", "AMS 500/50", "MC 900")
PAPER = {
    "Raw-MC": ("1.2e-2 ± 4.0e-3", "0 ± 0", "0 ± 0", "0 ± 0"),
    "Imp-Naive": ("1.4e-8 ± 2.5e-8", "2.8e-8 ± 8.4e-8", "2.0e-8 ± 3.9e-8", "0 ± 0"),
    "Imp-CE": ("7.1e-6 ± 2.1e-5", "7.6e-22 ± 2.2e-21", "4.4e-18 ± 8.9e-18", "0 ± 0"),
    "STL-AMS": ("8.8e-3 ± 6.2e-3", "1.5e-3 ± 2.1e-3", "4.7e-3 ± 3.4e-3", "3.5e-4 ± 1.8e-3"),
    "truth": ("9.1e-3", "2.0e-3", "3.6e-3", "4.8e-5"),
}
SIGMAS, ROUNDING = 3.0, 1e-9
"""Standard errors that a mean weight may be from 1, and what is no difference."""
TEMPLATE = Path(__file__).with_name("table2.md")
"""The page's text, with places for the tables."""


@dataclass(frozen=True)
class Study:
    """Stored outcomes of the study.

    Attributes:
        digest: Its fingerprint.
        steps: Of a rollout.
        truth: Rule -> the entry of the ground truth's file.
        outcomes: (rule, method) -> what its repetitions gave.
    """

    digest: str
    steps: int
    truth: dict[str, dict[str, Any]]
    outcomes: dict[tuple[str, str], list[dict[str, Any]]]


def ground_truth(truths: Path, scenario: Scenario) -> dict[str, Any]:
    """Return the stored summary of the many rollouts of the same system.

    Raises:
        SystemExit: There is no ground truth of these settings.
    """
    for file in sorted(truths.glob(f"{scenario.name}-*.json")):
        kept = json.loads(file.read_text(encoding="utf-8"))
        if "system" in kept and _part_of(kept["system"], scenario.resolved):
            return dict(kept)
    raise SystemExit("no ground truth of this scenario: benchmarks/ground_truth.py makes it")


def _part_of(known: Any, whole: Any) -> bool:
    """Tell whether every setting known before is the same; a new option has a default that was so."""
    if isinstance(known, dict) and isinstance(whole, dict):
        return all(name in whole and _part_of(value, whole[name]) for name, value in known.items())
    if isinstance(known, list) and isinstance(whole, list):
        return len(known) == len(whole) and all(map(_part_of, known, whole))
    return bool(known == whole)


def read(results: Path, kept: dict[str, Any]) -> Study:
    """Read the cells that belong to a ground truth."""
    digest = kept["fingerprint"]
    outcomes: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for file in sorted(results.glob(f"{digest[:8]}-*.json")):
        rule, method = file.stem.split("-", 1)[1].rsplit("-", 1)[0].split("-", 1)
        key = (rule, method.replace("_", " ").replace(":", "/"))
        outcomes.setdefault(key, []).append(json.loads(file.read_text(encoding="utf-8")))
    truth = {entry["specification"]: entry for entry in kept["estimates"]}
    return Study(digest, kept["system"]["steps"], truth, outcomes)


def page(study: Study) -> str:
    """Return the whole of docs/table2.md."""
    text = TEMPLATE.read_text(encoding="utf-8")
    parts = {"table": _table(study), "accuracy": _accuracy(study), "weights": _weights(study)}
    for name, lines in parts.items():
        text = text.replace(f"[{name}]", "\n".join(lines))
    return text


def _table(study: Study) -> Iterator[str]:
    yield f"| | {' | '.join(RULES)} |"
    yield "|---|" + "---|" * len(RULES)
    for method in METHODS:
        yield _row(method, [_mean_and_spread(study, rule, method) for rule in RULES])
        if method in PAPER:
            yield _row("*in the paper*", [f"*{text}*" for text in PAPER[method]])
    yield _row("**truth**, 95 % interval", [_with_interval(study.truth[rule]) for rule in RULES])
    yield _row("*in the paper*", [f"*{text}*" for text in PAPER["truth"]])


def _with_interval(entry: dict[str, Any]) -> str:
    low, high = entry["interval"]
    return f"**{_short(entry['probability'])}** ({_short(low)} .. {_short(high)})"


def _mean_and_spread(study: Study, rule: str, method: str) -> str:
    values = _values(study, rule, method)
    if len(values) < 2:
        return f"{_short(values[0])} (1 run)" if len(values) else "not run"
    number = "" if len(values) == 20 else f" ({len(values)} runs)"
    return f"{_short(values.mean())} ± {_short(values.std(ddof=1))}{number}"


def _accuracy(study: Study) -> Iterator[str]:
    yield f"| | {' | '.join(RULES)} |"
    yield "|---|" + "---|" * len(RULES)
    for method in METHODS:
        yield _row(method, [_accuracy_of(study, rule, method) for rule in RULES])


def _accuracy_of(study: Study, rule: str, method: str) -> str:
    values = _values(study, rule, method)
    truth, error = _truth(study, rule)
    if len(values) < 2 or not truth:
        return ""
    steps = np.mean([outcome["simulated_steps"] for outcome in study.outcomes[rule, method]]) / study.steps
    deviation = values.std(ddof=1)
    z = (values.mean() - truth) / math.hypot(deviation / math.sqrt(len(values)), error)
    square = ((values / truth - 1.0) ** 2).mean()
    score = f" ({z:+.1f})" if deviation else ""
    return f"{values.mean() / truth:.2f}{score}; {math.sqrt(square):.2f}; {square * steps:,.0f}"


def _weights(study: Study) -> Iterator[str]:
    keys = [(rule, method) for rule in RULES for method in ("Imp-Naive", "Imp-CE")]
    results = [result for key in keys for result in study.outcomes.get(key, [])]
    valid = [_valid(result) for result in results]
    flagged = [bool(result["health"]) for result in results]
    neither = sum(not v and not f for v, f in zip(valid, flagged, strict=True))
    yield f"Of {len(results)} results of both importance samplers {sum(valid)} have a mean weight within"
    yield f"3 errors of 1, {sum(flagged)} are flagged, and {neither} are neither."


def _valid(one: dict[str, Any]) -> bool:
    weights = one["diagnostics"]
    return bool(abs(weights["mean_weight"] - 1.0) <= SIGMAS * weights["mean_weight_error"] + ROUNDING)


def _values(study: Study, rule: str, method: str) -> np.ndarray:
    outcomes = study.outcomes.get((rule, method), [])
    return np.array([outcome["probability"] for outcome in outcomes])


def _truth(study: Study, rule: str) -> tuple[float, float]:
    """Return probability and its standard error."""
    entry = study.truth[rule]
    p = entry["probability"]
    return p, math.sqrt(p * (1.0 - p) / entry["rollouts"])


def _row(head: str, cells: list[str]) -> str:
    return f"| {head} | {' | '.join(cells)} |"


def _short(value: float) -> str:
    return "0" if value == 0.0 else f"{value:.2g}" if value >= 0.01 else f"{value:.1e}".replace("e-0", "e-")
