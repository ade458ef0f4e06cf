"""Baselines: numbered JSON files in a folder that can be committed; a check compares with the newest.

Two estimates of a specification are comparable if the world, its perception, the length of a rollout and the
specification are the same. Everything else may differ: the tracker and the controller are under test; the
estimator, its seed and its budget only set the precision.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, field_validator

from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.base.stored_files import check_model, check_seal, read_json, seal
from avrare.estimation.result.confidence_distributions import (
    decode_distribution,
    derive_distribution,
    encode_distribution,
)
from avrare.estimation.result.result import Result, finite
from avrare.results.provenance import describe_checkout
from avrare.results.stored_results import StoredEstimate
from avrare.scenario.fingerprint import digests, fingerprint
from avrare.scenario.schema import Scenario

SCHEMA = 1
SHARED_KEYS = ("steps", "simulator", "perception")
"""Keys of a resolved scenario that belong to the problem of every specification."""


class _StoredEntry(StoredEstimate):
    relative_error: float | None = Field(ge=0.0, le=1e6)  # that of 10^12 rollouts with one failure
    rollouts: int = Field(ge=1)
    simulated_steps: int = Field(ge=0)
    seconds: float = Field(ge=0.0)
    evidence: dict[str, Any]
    first: _StoredEntry | None = None

    def entry(self) -> Result:
        return replace(self.to_result(), interval_at=decode_distribution(self.evidence).interval_at)


class _StoredBaseline(BaseModel):
    model_config = ConfigDict(strict=True)

    schema_: int = Field(alias="schema")
    estimates: list[_StoredEntry]
    resolved: dict[str, Any]
    versions: dict[str, str]
    commit: str | None
    files: dict[str, str] = {}

    @field_validator("resolved")
    @classmethod
    def _has_specifications(cls, resolved: dict[str, object]) -> dict[str, object]:
        specifications = resolved.get("specifications")
        if not isinstance(specifications, dict) or not all(
            isinstance(specification, dict) for specification in specifications.values()
        ):
            raise ValueError("it holds no specifications")
        return resolved


@dataclass(frozen=True)
class Baseline:
    """Saved run."""

    path: Path
    scenario: Mapping[str, Any]  # the resolved one
    versions: Mapping[str, str]  # of avrare and the plugins
    commit: str | None  # of the scenario's repository
    entries: Mapping[str, Result]  # by specification; without tapes and diagnostics
    files: Mapping[str, str] = field(default_factory=dict)  # option -> digest of the file that it names
    firsts: Mapping[str, Result] = field(default_factory=dict)  # of the line, where it is an earlier one


def default_folder(scenario: Scenario) -> Path:
    """Return ``baselines/NAME`` next to the scenario's file."""
    return Path(scenario.path).parent / "baselines" / scenario.name


def read_newest(folder: Path) -> Baseline | None:
    """Read the baseline with the highest number; None if there is none."""
    numbers = _numbers(folder)
    return read(folder / numbers[max(numbers)]) if numbers else None


def read(path: Path) -> Baseline:
    """Read one baseline; UsageError if it cannot be read."""
    hint = "restore the file, or remove it to use the previous baseline"
    content = read_json(path, hint)
    if content.get("schema", SCHEMA) != SCHEMA:
        text = f"{path}: has schema {content['schema']!r}, this avrare reads schema {SCHEMA}"
        raise UsageError(text, hint)
    stored = check_model(_StoredBaseline, content, path, hint)
    try:
        entries = {estimate.specification: estimate.entry() for estimate in stored.estimates}
        firsts = {
            estimate.specification: estimate.first.entry()
            for estimate in stored.estimates
            if estimate.first is not None
        }
    except UsageError as error:
        raise UsageError(f"{path}: {error.message}", hint) from None
    check_seal(path, content, hint)
    return Baseline(path, stored.resolved, stored.versions, stored.commit, entries, stored.files, firsts)


def save(
    folder: Path,
    scenario: Scenario,
    results: Sequence[Result],
    firsts: Mapping[str, Result] | None = None,
) -> Path:
    """Write the results as the baseline with the next number; UsageError if that is not possible.

    ``firsts`` are the oldest baselines that these continue, by specification.
    """
    content = {
        "schema": SCHEMA,
        "scenario": scenario.name,
        "fingerprint": fingerprint(scenario),
        "commit": describe_checkout(Path(scenario.path).resolve().parent)[0],
        "versions": scenario.versions,
        "estimates": [_encode_result(result, (firsts or {}).get(result.specification)) for result in results],
        "resolved": scenario.resolved,
        "files": digests(scenario),
    }
    path = folder / f"{max(_numbers(folder), default=0) + 1:04d}.json"
    with explain_file_errors(f"{path}: cannot save the baseline", "choose another folder of baselines"):
        folder.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(seal(content), indent=1) + "\n")
    return path


def _numbers(folder: Path) -> dict[int, str]:
    with explain_file_errors(f"{folder}: cannot list the baselines"):
        names = [path.name for path in folder.iterdir()] if folder.exists() else []
    return {int(match[1]): name for name in names if (match := re.fullmatch(r"(\d{4,})\.json", name))}


def _encode_result(result: Result, first: Result | None) -> dict[str, object]:
    return _encode(result) | ({"first": _encode(first)} if first is not None else {})


def _encode(result: Result) -> dict[str, object]:
    # no comparison needs them; baselines are committed, and small
    omitted = ("warnings", "cross_check", "run_probabilities", "counts", "diagnostics")
    fields = {name: value for name, value in result.to_dict().items() if name not in omitted}
    return fields | {"evidence": finite(encode_distribution(derive_distribution(result)))}


def find_differences(old: Mapping[str, Any], new: Mapping[str, Any], specifications: list[str]) -> list[str]:
    """List how two resolved scenarios differ in their problem, as ``simulator.dt 0.1 -> 0.05``.

    A specification that only one of them has does not count.
    """
    differences = [line for key in SHARED_KEYS for line in _list_differences(key, old.get(key), new.get(key))]
    definitions = [scenario.get("specifications", {}) for scenario in (old, new)]
    for name in specifications:
        if all(name in definition for definition in definitions):
            differences += _list_differences(
                f"specifications.{name}", *(definition[name] for definition in definitions)
            )
    return differences


def summarise_differences(lines: Sequence[str]) -> str:
    """Return the first few differences on one line."""
    limit = 5
    more = len(lines) - limit
    return ", ".join(lines[:limit]) + (f", and {more} more" if more > 0 else "")


def _list_differences(path: str, old: object, new: object) -> Iterator[str]:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        if old.get("plugin") != new.get("plugin"):  # their options have nothing in common
            yield f"{path}.plugin {_shorten(old.get('plugin'))} -> {_shorten(new.get('plugin'))}"
            return
        for key in [*old, *(key for key in new if key not in old)]:
            # A score orders particles for the estimator and is no part of the specification.
            if not (path.startswith("specifications.") and key == "score"):
                yield from _list_differences(f"{path}.{key}", old.get(key), new.get(key))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from _list_differences(f"{path}.{index}", before, after)
    elif old != new:
        yield f"{path} {_shorten(old)} -> {_shorten(new)}"


def _shorten(value: object) -> str:
    if value is None:
        return "none"
    if isinstance(value, Mapping):
        return str(value.get("plugin", "{...}"))
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
