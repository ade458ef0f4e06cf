"""Entry of a history: one estimate at one commit."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from avrare.base.visible_text import spell_line
from avrare.results.reader import RunFolder, StoredEstimate, read_run_folder


@dataclass(frozen=True)
class HistoryEntry:
    """Stored estimate."""

    id: str  # digest of the estimate without its wall time; equal for equal estimates
    written: str  # time of the run, as ``2026-11-21T19:57:03+00:00``
    revision: str  # commit of the scenario's folder, or empty
    changed: bool  # there were uncommitted changes
    scenario: str
    fingerprint: str  # of scenario and versions; estimates with different ones are not comparable
    specification: str
    estimator: str
    seed: int
    probability: float
    low: float  # ends of the interval
    high: float
    confidence: float
    rollouts: int
    steps: int
    failures: int
    errors: int
    seconds: float
    health: str  # names of the warnings, separated by commas
    verdict: str  # "pass", "fail", "inconclusive", or empty

    @staticmethod
    def from_row(row: Sequence[Any]) -> HistoryEntry:
        """Return the entry in a row of the database; ValueError if a value cannot be one."""
        values = (spell_line(value) if isinstance(value, str) else value for value in row)
        found = _row_reader().validate_python(dict(zip(FIELDS, values, strict=True)))
        datetime.fromisoformat(found.written)
        if not all(0.0 <= one <= 1.0 for one in (found.probability, found.low, found.high, found.confidence)):
            raise ValueError("a probability is not between 0 and 1")
        if found.verdict not in ("", "pass", "fail", "inconclusive"):
            raise ValueError(f"verdict {found.verdict!r} is unknown")
        return found

    @property
    def when(self) -> datetime:
        """Time of the run as a datetime."""
        found = datetime.fromisoformat(self.written)
        return found if found.tzinfo else found.replace(tzinfo=UTC)

    @property
    def commit(self) -> str:
        """Short commit, with a star for uncommitted changes."""
        return f"{self.revision[:10] or 'no commit'}{'*' if self.changed else ''}"


@functools.cache
def _row_reader() -> TypeAdapter[HistoryEntry]:
    return TypeAdapter(HistoryEntry)


FIELDS = tuple(one.name for one in fields(HistoryEntry))
"""Columns of the database."""


def read_entries(folder: Path) -> list[HistoryEntry]:
    """Read the estimates of a run folder, or of all runs in a folder; UsageError if there is no valid run."""
    several = [] if (folder / "result.json").exists() else sorted(folder.glob("*/result.json"))
    if several:
        return [entry for one in several for entry in read_entries(one.parent)]
    run = read_run_folder(folder)
    pairs = zip(run.result.estimates, run.content["estimates"], strict=True)
    return [_make_entry(run, estimate, stored) for estimate, stored in pairs]


def group_series(entries: Sequence[HistoryEntry]) -> Iterator[tuple[tuple[str, str], list[HistoryEntry]]]:
    """Yield each (scenario, specification) with its entries, the oldest first."""

    def name(entry: HistoryEntry) -> tuple[str, str]:
        return entry.scenario, entry.specification

    for key, group in groupby(sorted(entries, key=lambda one: (*name(one), one.when)), name):
        yield key, list(group)


def find_breaks(series: Sequence[HistoryEntry]) -> list[bool]:
    """Return for each entry of a series whether its fingerprint differs from the one before."""
    return [k > 0 and series[k - 1].fingerprint != one.fingerprint for k, one in enumerate(series)]


def _make_entry(run: RunFolder, estimate: StoredEstimate, stored: dict[str, Any]) -> HistoryEntry:
    result, revision = run.result, run.provenance.commit
    same = {key: value for key, value in stored.items() if key != "seconds"}
    content = [result.scenario, result.fingerprint, result.seed, revision, same]
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    low, high = estimate.interval
    return HistoryEntry(
        id=digest[:32],
        written=run.written.isoformat(timespec="seconds"),
        revision=revision,
        changed=run.provenance.uncommitted_changes,
        scenario=result.scenario,
        fingerprint=result.fingerprint,
        specification=estimate.specification,
        estimator=estimate.estimator,
        seed=result.seed,
        probability=estimate.probability,
        low=low,
        high=high,
        confidence=estimate.confidence,
        rollouts=estimate.rollouts,
        steps=estimate.simulated_steps,
        failures=estimate.failures,
        errors=estimate.errors,
        seconds=estimate.seconds,
        health=",".join(estimate.health),
        verdict=estimate.verdict or "",
    )
