"""Next steps after a check: how a failure is replayed, and how many rollouts would decide a row."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from avrare.analysis.check.criteria import Criterion, Decision, find_assumption, find_objections
from avrare.analysis.check.gate import CheckResult
from avrare.analysis.check.power_analysis import count_settling_rollouts, counts_failures, estimate_costs
from avrare.analysis.check.targets import CheckTarget
from avrare.analysis.failures.failure import record_failure
from avrare.base.errors import UsageError
from avrare.estimation.result.result import Result
from avrare.scenario.schema import Regression, Threshold


def with_next_steps(outcome: CheckResult, targets: Sequence[CheckTarget], out: Path | None) -> CheckResult:
    """Return the outcome with a next step in each row that fails or is inconclusive.

    Args:
        outcome: Decided check.
        targets: Its scenarios.
        out: Folder of the run folders, where they are written.
    """
    target_by_name = {target.name: target for target in targets}
    results_by_name = {
        (name, result.specification): result
        for name, results in outcome.results.items()
        for result in results
    }
    decisions = []
    for decision in outcome.decisions:
        target = target_by_name[decision.scenario]
        result = results_by_name.get((decision.scenario, decision.specification))
        step = "" if result is None else _find_step(target, decision, result, out, len(targets) > 1)
        decisions.append(replace(decision, next_step=step))
    return replace(outcome, decisions=tuple(decisions))


def _find_step(
    target: CheckTarget, decision: Decision, result: Result, out: Path | None, several: bool
) -> str:
    if decision.verdict == "pass":
        return ""
    if decision.verdict == "fail":
        return _replay_step(target, result, out / target.name if out is not None and several else out)
    key = (decision.specification, decision.question)
    criteria = [
        criterion for criterion in target.criteria if (criterion.specification, criterion.question) == key
    ]
    if not criteria or find_objections(criteria[0], result):  # a warning is not cured by more rollouts alone
        return ""
    if find_assumption(criteria[0], result):
        return _settling_size(criteria[0].condition, result)
    return _decisive_size(target, criteria[0], result)


def _replay_step(target: CheckTarget, result: Result, folder: Path | None) -> str:
    if not len(result.failures.robustness):
        return ""
    worst = int(result.failures.robustness.argmin())
    with suppress(UsageError):  # a stack that is not reproducible: its warning says so
        failure = record_failure(target.scenario, result.specification, result.failures.noise[worst])
        if folder is None:
            return f"failure {failure.id}: a folder for the results keeps it for a replay"
        words = ["avrare", "replay", target.definition.path, "--run", str(folder), "--specification"]
        return f"failure {failure.id}: {shlex.join([*words, result.specification])}"
    return ""


def _settling_size(condition: Threshold | Regression, result: Result) -> str:
    assert isinstance(condition, Threshold)
    rollouts = count_settling_rollouts(condition, result.probability)
    return "" if rollouts is None else f"about {rollouts:,} rollouts of Monte Carlo would settle it"


def _decisive_size(target: CheckTarget, criterion: Criterion, result: Result) -> str:
    entries = {result.specification: result}
    # All criteria share the error rate, so the number of them enters; the first price is that of this one.
    criteria = [criterion, *(other for other in target.criteria if other is not criterion)]
    cost, *_ = estimate_costs(target.name, criteria, entries, "this check", target.definition.confidence)
    if cost.rollouts is None:
        return cost.reason
    rollouts = cost.rollouts if counts_failures(result) else max(cost.rollouts, 2 * result.rollouts)
    command = f"avrare check {shlex.quote(target.definition.path)} --budget rollouts={rollouts}"
    return f"about {rollouts:,} rollouts would decide it in 9 of 10 cases: {command}"
