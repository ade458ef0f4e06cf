"""Finished checks: their rows are read again where the check is the same, and the code does the same."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from avrare.analysis.check.baseline_files import read_newest
from avrare.analysis.check.criteria import Decision
from avrare.analysis.check.gate import CheckResult
from avrare.analysis.check.targets import CheckTarget
from avrare.base.atomic_files import remove_torn
from avrare.base.errors import UsageError
from avrare.base.stored_files import check_seal, read_json, seal
from avrare.estimation.budget import Budget
from avrare.estimation.checkpoint import FOLDER, Checkpoint, differences
from avrare.results.reader import read_rollouts
from avrare.scenario.fingerprint import fingerprint

CHECK = "check.json"
_AFRESH = "choose another folder, or remove it to check afresh"
_SAME = 1e-6
"""Relative difference of the robustness of a rollout that another machine or library may make."""


@dataclass(frozen=True)
class StoredEstimate:
    """Estimate of a finished check, with what its reports say of it."""

    specification: str
    health: Mapping[str, str]
    seconds: float
    blind_bound: float | None


def describe_settings(
    targets: Sequence[CheckTarget], budget: Budget | None, looks: int, *, save: bool, accept_changes: bool
) -> dict[str, Any]:
    """Return what must be equal for a check to be the same, before it runs."""
    return {
        "scenarios": {
            one.name: {"seed": one.definition.seed, "fingerprint": fingerprint(one.definition)}
            for one in targets
        },
        "budget": None if budget is None else f"{budget.kind}={budget.amount!r}",
        "looks": looks,
        "save": save,
        "accept_changes": accept_changes,
        "baselines": {one.name: one.baseline.path.name if one.baseline else None for one in targets},
    }


def to_content(
    outcome: CheckResult, targets: Sequence[CheckTarget], settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the content of check.json; the baselines that the check itself has saved are none of others."""
    newest = {one.name: read_newest(one.folder) for one in targets if one.compared}
    saved = {name: baseline.path.name for name, baseline in newest.items() if baseline is not None}
    return seal({**outcome.to_dict(targets), "settings": {**settings, "saved": saved}})


def read_finished(
    out: Path, targets: Sequence[CheckTarget], settings: Mapping[str, Any]
) -> tuple[CheckResult, dict[str, Any]] | None:
    """Return the outcome of the finished check in a folder, and its check.json; None where there is none.

    Raises:
        UsageError: It is of another check, or a rollout of it, run again, is another one.
    """
    file = out / CHECK
    if not file.exists():
        return None
    content = read_json(file, _AFRESH)
    check_seal(file, content, f"restore the file; else {_AFRESH}")
    if not isinstance(content.get("settings"), dict):
        raise UsageError(f"{file}: contains the result of an earlier version of avrare", _AFRESH)
    stored = dict(content["settings"])
    saved = stored.pop("saved", {})
    wanted = dict(settings)
    if wanted["baselines"] == {**stored.get("baselines", {}), **saved}:
        wanted["baselines"] = stored.get("baselines")
    if changes := differences(stored, wanted):
        raise UsageError(f"{out}: contains the result of another check: {'; '.join(changes)}", _AFRESH)
    try:
        outcome = _read_outcome(content)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UsageError(f"{file}: cannot be read: {type(error).__name__}: {error}", _AFRESH) from None
    for target in targets:
        _check_code(out / target.name if len(targets) > 1 else out, target, outcome)
    Checkpoint(out / FOLDER, {}).remove()  # left by a process that was killed after it had finished
    remove_torn(out)
    return outcome, content


def _read_outcome(content: Mapping[str, Any]) -> CheckResult:
    results: dict[str, Any] = {
        one["scenario"]: tuple(
            StoredEstimate(
                entry["specification"],
                {name: (entry.get("warnings") or {}).get(name, name) for name in entry["health"]},
                float(entry["seconds"]),
                entry.get("blind_bound"),
            )
            for entry in one["estimates"]
        )
        for one in content["results"]
    }
    decisions = tuple(_read_decision(row) for row in content["rows"])
    return CheckResult(decisions, results, tuple(map(str, content["notes"])), int(content["looks"]))


def _read_decision(row: Mapping[str, Any]) -> Decision:
    fields = dict(row)
    for name in ("interval", "change_interval"):
        if fields[name] is not None:
            low, high = fields[name]
            fields[name] = (float(low), math.inf if high is None else float(high))  # JSON has no infinity
    if fields["change"] is None and fields["baseline"] == 0.0 and fields["probability"]:
        fields["change"] = math.inf
    return Decision(**fields)


def _check_code(folder: Path, target: CheckTarget, outcome: CheckResult) -> None:
    """Run the least robust rollout of each estimate again: the code under test may be another one by now."""
    samples = read_rollouts(folder)
    for one in outcome.results[target.name]:
        worst = samples[one.specification].worst if one.specification in samples else None
        if worst is None or math.isnan(worst.robustness) or "not_deterministic" in one.health:
            continue
        again = target.scenario.problem(one.specification).replay(worst.noise[None])
        now = math.nan if again.error[0] else float(again.robustness[0, 0])
        if not math.isclose(now, worst.robustness, rel_tol=_SAME, abs_tol=_SAME):
            text = f"{folder}: the code has changed since this check: a rollout of {one.specification} has"
            raise UsageError(f"{text} robustness {worst.robustness:.6g} -> {now:.6g}", _AFRESH)
