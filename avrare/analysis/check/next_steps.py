"""Next steps after a check: how a failure is replayed, and how many rollouts would decide a row."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from avrare.analysis.check.baseline_files import BaselineEntry
from avrare.analysis.check.criteria import Decision, find_objections
from avrare.analysis.check.gate import CheckResult
from avrare.analysis.check.power_analysis import estimate_costs
from avrare.analysis.check.targets import CheckTarget
from avrare.analysis.failures.failure import record_failure
from avrare.base.errors import UsageError
from avrare.estimation.result.result import Result


def with_next_steps(outcome: CheckResult, targets: Sequence[CheckTarget], out: Path | None) -> CheckResult:
    """Return the outcome with a next step in each row that fails or is inconclusive.

    Args:
        outcome: Decided check.
        targets: Its scenarios.
        out: Folder of the run folders, where they are written.
    """
    by_name = {target.name: target for target in targets}
    found = {(name, one.specification): one for name, results in outcome.results.items() for one in results}
    decisions = []
    for one in outcome.decisions:
        target, result = by_name[one.scenario], found.get((one.scenario, one.specification))
        step = ""
        if result is not None and one.verdict == "fail":
            folder = None if out is None else out / target.name if len(targets) > 1 else out
            step = _replay_step(target, result, folder)
        elif result is not None and one.verdict == "inconclusive":
            step = _decisive_size(target, one, result)
        decisions.append(replace(one, next_step=step))
    return replace(outcome, decisions=tuple(decisions))


def _replay_step(target: CheckTarget, result: Result, folder: Path | None) -> str:
    if not len(result.failures.robustness):
        return ""
    worst = int(result.failures.robustness.argmin())
    with suppress(UsageError):  # a stack that is not reproducible: its warning says so
        failure = record_failure(target.scenario, result.specification, result.failures.noise[worst])
        if folder is None:
            return f"failure {failure.id}: --out DIR keeps it for `avrare replay`"
        words = ["avrare", "replay", target.definition.path, "--run", str(folder), "--specification"]
        return f"failure {failure.id}: {shlex.join([*words, result.specification])}"
    return ""


def _decisive_size(target: CheckTarget, decision: Decision, result: Result) -> str:
    criteria = [
        one
        for one in target.criteria
        if (one.specification, one.question) == (decision.specification, decision.question)
    ]
    if not criteria or find_objections(criteria[0], result):  # a warning is not cured by more rollouts alone
        return ""
    entries = {result.specification: BaselineEntry.from_result(result)}
    # All criteria share the error rate, so the number of them enters; the first price is that of this one.
    others = [one for one in target.criteria if one is not criteria[0]]
    confidence = target.definition.confidence
    cost, *_ = estimate_costs(target.name, [*criteria, *others], entries, "this check", confidence)
    if cost.rollouts is None:
        return cost.reason
    spend = f"--spend rollouts={cost.rollouts}"
    return f"about {cost.rollouts:,} rollouts would decide it in 9 of 10 cases ({spend})"
