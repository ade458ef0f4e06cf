"""Baselines: numbered JSON files in a folder that can be committed; the newest is the one to compare with."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from avrare.check.evidence import Evidence, evidence_of, from_plain, to_plain
from avrare.errors import UsageError
from avrare.estimation.result import Result, finite
from avrare.record.rundir import provenance
from avrare.record.whole import write_text
from avrare.scenario.files import digests
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.schema import Scenario

SCHEMA = 1
_NAME = re.compile(r"(\d{4,})\.json")
_HINT = "restore the file, or remove it: then the one before counts"


@dataclass(frozen=True)
class Entry:
    """A rule in a baseline.

    Attributes:
        specification: Its name.
        probability: The estimate.
        evidence: What the estimate says.
        relative_error: Of the estimate; NaN where the probability is 0.
        rollouts: What it cost.
        simulated_steps: What it cost.
        seconds: What it took.
        health: Names of its warnings.
        relation: What counted as failure.
    """

    specification: str
    probability: float
    evidence: Evidence
    relative_error: float
    rollouts: int
    simulated_steps: int
    seconds: float
    health: tuple[str, ...]
    relation: str

    @staticmethod
    def of(result: Result) -> Entry:
        """What a baseline keeps of a result."""
        return Entry(
            result.specification, result.probability, evidence_of(result), result.relative_error,
            result.rollouts, result.simulated_steps, result.seconds, tuple(result.health), result.relation,
        )  # fmt: skip


@dataclass(frozen=True)
class Baseline:
    """A saved run.

    Attributes:
        path: Its file.
        scenario: The resolved scenario.
        versions: Of avrare and the plugins.
        commit: The commit that the scenario belonged to, None if there was none.
        entries: Specification -> what was found.
        files: Option that names a file -> digest of its content.
    """

    path: Path
    scenario: Mapping[str, Any]
    versions: Mapping[str, str]
    commit: str | None
    entries: Mapping[str, Entry]
    files: Mapping[str, str] = field(default_factory=dict)


def default_folder(scenario: Scenario) -> Path:
    """``baselines/NAME`` next to the scenario's file."""
    return Path(scenario.path).parent / "baselines" / scenario.name


def newest(folder: Path) -> Baseline | None:
    """The baseline with the highest number; None where there is none.

    Raises:
        UsageError: It cannot be read.
    """
    numbers = _numbers(folder)
    return read(folder / numbers[max(numbers)]) if numbers else None


def read(path: Path) -> Baseline:
    """One baseline.

    Raises:
        UsageError: It cannot be read.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            raise UsageError(f"written in form {content['schema']!r}, this avrare reads {SCHEMA}")
        entries = {one["specification"]: _entry(one) for one in content["estimates"]}
        resolved, versions = dict(content["resolved"]), dict(content["versions"])
        return Baseline(path, resolved, versions, content["commit"], entries, dict(content.get("files", {})))
    except UsageError as error:
        raise UsageError(f"{path}: {error.message}", _HINT) from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        reason = f"no {error} in it" if isinstance(error, KeyError) else str(error)
        raise UsageError(f"{path}: not a baseline that can be read: {reason}", _HINT) from None


def save(folder: Path, scenario: Scenario, results: Sequence[Result]) -> Path:
    """Write the next number.

    Raises:
        UsageError: The folder cannot be written to.
    """
    content = {
        "schema": SCHEMA,
        "scenario": scenario.name,
        "fingerprint": fingerprint(scenario),
        "commit": provenance(scenario)["commit"],
        "versions": scenario.versions,
        "estimates": [_plain(result) for result in results],
        "resolved": scenario.resolved,
        "files": digests(scenario),
    }
    path = folder / f"{max(_numbers(folder), default=0) + 1:04d}.json"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(content, indent=1) + "\n")
    except OSError as error:
        text = f"{path}: cannot save the baseline: {error.strerror or error}"
        raise UsageError(text, "choose another folder with --baseline") from None
    return path


def _numbers(folder: Path) -> dict[int, str]:
    try:
        names = [path.name for path in folder.iterdir()] if folder.exists() else []
    except OSError as error:
        raise UsageError(f"{folder}: cannot look for baselines: {error.strerror or error}") from None
    return {int(found[1]): name for name in names if (found := _NAME.fullmatch(name))}


def _plain(result: Result) -> dict[str, Any]:
    entry = Entry.of(result)
    fields = {
        key: getattr(entry, key)
        for key in ("specification", "probability", "relative_error", "rollouts", "simulated_steps")
    }
    fields |= {"seconds": round(entry.seconds, 3), "health": list(entry.health), "relation": entry.relation}
    about = {
        "estimator": result.estimator,
        "interval": list(result.interval),
        "confidence": result.confidence,
    }
    return dict(finite({**fields, **about, "evidence": to_plain(entry.evidence)}))


def _entry(plain: Mapping[str, Any]) -> Entry:
    error = plain["relative_error"]
    return Entry(
        str(plain["specification"]), float(plain["probability"]), from_plain(plain["evidence"]),
        float("nan") if error is None else float(error), int(plain["rollouts"]),
        int(plain["simulated_steps"]), float(plain["seconds"]), tuple(plain["health"]),
        str(plain["relation"]),
    )  # fmt: skip
