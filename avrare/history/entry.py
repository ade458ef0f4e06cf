"""One estimate at one commit, as a history keeps it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import Any

from avrare.record.written import read_json, read_result, written_at


@dataclass(frozen=True)
class Entry:
    """One estimate.

    Attributes:
        id: Two estimates with the same are the same: the time that it took does not count.
        written: When, as ``2026-11-21T19:57:03+00:00``.
        revision: Commit of the scenario's folder; empty where there was none.
        changed: There were uncommitted changes.
        scenario: Its name.
        fingerprint: Of scenario and versions; where it changes, another question was answered.
        specification: Its name.
        estimator: Its name.
        seed: Of the run.
        probability: The estimate.
        low: Lower end of the interval.
        high: Upper end of the interval.
        confidence: Of the interval.
        rollouts: Simulations.
        steps: Simulated steps.
        failures: Failing simulations.
        errors: Simulations that broke down.
        seconds: Wall time.
        health: Names of the warnings, with commas.
        verdict: "pass", "fail", "inconclusive", or empty.
    """

    id: str
    written: str
    revision: str
    changed: bool
    scenario: str
    fingerprint: str
    specification: str
    estimator: str
    seed: int
    probability: float
    low: float
    high: float
    confidence: float
    rollouts: int
    steps: int
    failures: int
    errors: int
    seconds: float
    health: str
    verdict: str

    @property
    def when(self) -> datetime:
        """The same as ``written``."""
        return datetime.fromisoformat(self.written)

    @property
    def commit(self) -> str:
        """Short, with a star for uncommitted changes."""
        return f"{self.revision[:10] or 'no commit'}{'*' if self.changed else ''}"

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def entries(folder: Path) -> list[Entry]:
    """The estimates of a run's folder, or of all runs in a folder of several.

    Raises:
        UsageError: There is no run in it, or its files are damaged.
    """
    several = [] if (folder / "result.json").exists() else sorted(folder.glob("*/result.json"))
    if several:
        return [entry for one in several for entry in entries(one.parent)]
    result = read_result(folder)
    file = folder / "provenance.json"
    origin = read_json(file) if file.is_file() else {}
    written = written_at(folder).isoformat(timespec="seconds")
    return [_entry(result, origin, written, estimate) for estimate in result["estimates"]]


def series(found: Sequence[Entry]) -> Iterator[tuple[tuple[str, str], list[Entry]]]:
    """(scenario, specification) and its entries, the oldest first."""

    def name(entry: Entry) -> tuple[str, str]:
        return entry.scenario, entry.specification

    for key, group in groupby(sorted(found, key=lambda one: (*name(one), one.when)), name):
        yield key, list(group)


def breaks(found: Sequence[Entry]) -> list[bool]:
    """Whether each entry of a series answers another question than the one before it."""
    return [k > 0 and found[k - 1].fingerprint != one.fingerprint for k, one in enumerate(found)]


def _entry(result: dict[str, Any], origin: dict[str, Any], written: str, estimate: dict[str, Any]) -> Entry:
    low, high = estimate["interval"]
    revision = str(origin.get("commit") or "")
    same = {key: value for key, value in estimate.items() if key != "seconds"}
    content = [result["scenario"], result["fingerprint"], result["seed"], revision, same]
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    return Entry(
        id=digest[:32],
        written=written,
        revision=revision,
        changed=bool(origin.get("uncommitted_changes")),
        scenario=str(result["scenario"]),
        fingerprint=str(result["fingerprint"]),
        specification=str(estimate["specification"]),
        estimator=str(estimate["estimator"]),
        seed=int(result["seed"]),
        probability=float(estimate["probability"]),
        low=float(low),
        high=float(high),
        confidence=float(estimate["confidence"]),
        rollouts=int(estimate["rollouts"]),
        steps=int(estimate["simulated_steps"]),
        failures=int(estimate["failures"]),
        errors=int(estimate["errors"]),
        seconds=float(estimate["seconds"]),
        health=",".join(estimate["health"]),
        verdict=str(estimate["verdict"] or ""),
    )
