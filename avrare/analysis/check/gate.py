"""Regression gate: estimate, decide every criterion, look again where needed, and save baselines."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from avrare.analysis.check import baseline_files as baseline
from avrare.analysis.check.criteria import (
    Criterion,
    Decision,
    assess,
    decide_criteria,
    describe_health,
    describe_unknown_change,
    find_assumption,
    find_objections,
    make_decision,
)
from avrare.analysis.check.pooling import pool
from avrare.analysis.check.targets import CheckTarget, Look, estimate_look
from avrare.base.errors import ExitCode, UsageError
from avrare.base.number_format import format_interval, format_probability
from avrare.base.records import Answer, Records
from avrare.estimation.combine.specifications import Execution
from avrare.estimation.estimate import check_scenarios
from avrare.estimation.result.result import Result, finite
from avrare.estimation.result.verdict import worst_verdict
from avrare.results.run import Run

SCHEMA = 1


@dataclass(frozen=True, repr=False)
class CheckResult(Answer):
    """Result of a check.

    Attributes:
        decisions: One for each criterion, and for each specification without a baseline.
        results: Results of each scenario, with the verdicts of their thresholds.
        notes: Lines on baselines.
        looks: Number of interim looks.
        targets: The scenarios; none for a catalogue.
        strict: A threshold that holds only as far as the search could see is not enough for exit code 0.
        has_too_many_errors: More rollouts of a catalogue's scene ended in an error than it allows.
    """

    decisions: tuple[Decision, ...]
    results: dict[str, tuple[Result, ...]]
    notes: tuple[str, ...] = ()
    looks: int = 1
    targets: tuple[CheckTarget, ...] = ()
    strict: bool = False
    has_too_many_errors: bool = False

    @property
    def exit_code(self) -> ExitCode:
        """Exit code: too many errors take precedence over the worst verdict."""
        broken = any("errors" in result.health for results in self.results.values() for result in results)
        if broken or self.has_too_many_errors:
            return ExitCode.ROLLOUT_ERRORS
        if self.verdict == "pass_assuming":
            return ExitCode.INCONCLUSIVE if self.strict else ExitCode.PASS
        codes = {"fail": ExitCode.FAIL, "inconclusive": ExitCode.INCONCLUSIVE, "pass": ExitCode.PASS}
        return codes[self.verdict]

    @property
    def verdict(self) -> str:
        """Worst verdict of all decisions."""
        return worst_verdict(decision.verdict for decision in self.decisions) or "pass"

    def has_errors(self, decision: Decision) -> bool:
        """Return whether the estimate of a decision has more errors than allowed."""
        results = self.results.get(decision.scenario, ())
        return any(
            "errors" in result.health for result in results if result.specification == decision.specification
        )

    def table(self) -> Records:
        """Return one row for each decision."""
        return Records(
            {
                "scenario": decision.scenario,
                "specification": decision.specification,
                "required": decision.question,
                "verdict": decision.verdict,
                "probability": decision.probability,
                "low": decision.interval and decision.interval[0],
                "high": decision.interval and decision.interval[1],
                "baseline": decision.baseline,
                "change": decision.change,
                "reason": decision.reason,
                "next_step": decision.next_step,
            }
            for decision in self.decisions
        )

    def lines(self) -> list[str]:
        """Return ``drive in_lane < 0.1: pass, 0.05 (0.04 .. 0.06)`` for each decision, and the verdict."""
        return [*map(_describe_decision, self.decisions), f"{self.verdict}{self.details}"]

    @property
    def details(self) -> str:
        """Number of looks, exit code and its reason, as they follow the verdict."""
        looks = f" after {self.looks} looks" if self.looks > 1 else ""
        too_many = self.exit_code == ExitCode.ROLLOUT_ERRORS
        reason = ": more rollouts broke down than the scenario allows" if too_many else ""
        return f"{looks}, exit code {int(self.exit_code)}{reason}"

    def to_dict(self) -> dict[str, object]:
        """Return the content of check.json."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "exit_code": int(self.exit_code),
            "looks": self.looks,
            "rows": [finite(vars(decision)) for decision in self.decisions],  # infinities become null
            "notes": list(self.notes),
            "baselines": {
                target.name: str(target.baseline.path)
                for target in self.targets
                if target.baseline is not None
            },
            "results": [
                Run.of_scenario(target.definition, self.results[target.name]).to_dict()
                for target in self.targets
            ],
        }


def _describe_decision(decision: Decision) -> str:
    name = f"{decision.scenario} {decision.specification} {decision.question}"
    estimate = "" if decision.probability is None else f", {format_probability(decision.probability)}"
    estimate += f" ({format_interval(decision.interval)})" if decision.interval else ""
    reason = f": {decision.reason}" if decision.reason and decision.verdict != "pass" else ""
    return f"{name}: {decision.verdict}{estimate}{reason}"


@dataclass
class _CheckState:
    criteria: list[Criterion]
    verdicts: dict[int, str] = field(default_factory=dict)  # by number of the criterion
    batches: dict[tuple[str, str], list[Result]] = field(default_factory=dict)  # by scenario, specification
    looks: int = 0

    def specifications_to_estimate(self, target: CheckTarget, save: bool) -> list[str]:
        specifications = list(target.definition.estimated)
        # A target that will be saved takes every look: optional stopping would bias its baseline.
        if not self.looks or save or (target.compared and target.baseline is None):
            return specifications
        undecided = {
            criterion.specification
            for number, criterion in enumerate(self.criteria)
            if number not in self.verdicts and criterion.scenario == target.name
        }
        return [name for name in specifications if name in undecided]


def check_targets(
    targets: Sequence[CheckTarget], looks: Sequence[Look], execution: Execution, save: bool
) -> CheckResult:
    """Decide, and save first baselines of healthy results and requested ones; arguments as in ``decide``."""
    outcome = decide(targets, looks, execution, save)
    decisions, notes = list(outcome.decisions), []
    for target in targets:
        results = outcome.results[target.name]
        notes += [f"{target.name}: {note}" for note in target.notes]
        if not target.compared:
            continue
        healthy = not any(result.health or result.verdict == "fail" for result in results)
        path, obstacle = None, ""
        if save or (target.baseline is None and healthy):
            path, note = _try_to_save(target, results)
            notes.append(f"{target.name}: {note}")
            notes += [] if path is None else target.describe_coarse(results)
            obstacle = "the file could not be written"
        entries = target.baseline.entries if target.baseline is not None else {}
        decisions += [
            _decide_without_baseline(target, result, path, obstacle)
            for result in results
            if result.specification not in entries
        ]
    order = {target.name: number for number, target in enumerate(targets)}
    decisions.sort(key=lambda decision: order[decision.scenario])
    return replace(outcome, decisions=tuple(decisions), notes=tuple(notes))


def decide(
    targets: Sequence[CheckTarget], looks: Sequence[Look], execution: Execution, save: bool = False
) -> CheckResult:
    """Decide the criteria of several scenarios, which share one error rate, in the planned looks.

    Results that will be saved as baselines (``save``) take every look. UsageError if an estimator cannot take
    the problem or the budget.
    """
    state = _CheckState([criterion for target in targets for criterion in target.criteria])
    max_error_rates = {target.name: target.definition.max_error_rate for target in targets}

    def result(criterion: Criterion) -> Result | None:
        batches = state.batches.get((criterion.scenario, criterion.specification))
        return pool(batches, max_error_rates[criterion.scenario]) if batches else None

    with _explain_share(looks[0]):
        check_scenarios([(target.scenario, looks[0].budget) for target in targets])
    for look in looks:
        # 1. Select what is still open.
        work = [
            (target, names) for target in targets if (names := state.specifications_to_estimate(target, save))
        ]
        if not work:
            break
        # 2. Draw a batch of each.
        for target, names in work:
            with _explain_share(look):
                batch = estimate_look(target.scenario, names, look, execution, target.find_goal(save))
            for estimate in batch:
                state.batches.setdefault((target.name, estimate.specification), []).append(estimate)
        # 3. Decide on all batches so far.
        state.verdicts = decide_criteria(state.criteria, result, look.share, state.verdicts)
        state.looks += 1
    decisions = [
        _decide(state, number, criterion, result(criterion))
        for number, criterion in enumerate(state.criteria)
    ]
    results = {target.name: _pool_results(target, state, decisions) for target in targets}
    return CheckResult(tuple(decisions), results, looks=state.looks, targets=tuple(targets))


@contextmanager
def _explain_share(look: Look) -> Iterator[None]:
    try:
        yield
    except UsageError as error:
        if look.share == 1.0 or "does not pay" not in error.message:
            raise
        hint = f"the budget is divided into looks; the first has {look.share:g} of it"
        raise UsageError(error.message, hint) from None


def _decide(state: _CheckState, number: int, criterion: Criterion, result: Result | None) -> Decision:
    verdict = state.verdicts.get(number, "inconclusive")
    if result is None:
        reason = "not estimated: estimator.specifications leaves it out"
        return make_decision(criterion, verdict, reason, None)
    decision = make_decision(criterion, verdict, "", result)
    return replace(decision, reason=_find_reason(criterion, decision, result, len(state.criteria)))


def _find_reason(criterion: Criterion, decision: Decision, result: Result, criteria: int) -> str:
    if decision.verdict == "pass_assuming":
        return find_assumption(criterion, result)
    if decision.verdict == "pass":
        return describe_unknown_change(criterion, result)
    objections = find_objections(criterion, result)
    interval = _describe_interval(decision)
    if decision.verdict == "fail":
        return "; ".join([interval, *objections])
    fails_alone = assess(criterion, result, 1.0).normalised_p_value <= 1.0
    if objections:
        return "; ".join([f"{interval}: would fail, but for a warning"] * fails_alone + objections)
    if fails_alone:
        corrected = f"not after correction for {criteria} criteria or several looks"
        return f"{interval}: fails on its own, but {corrected}"
    unknown = describe_unknown_change(criterion, result)
    return unknown or f"{interval}: {find_assumption(criterion, result) or 'use more rollouts'}"


def _describe_interval(decision: Decision) -> str:
    if decision.change_interval is None:
        assert decision.interval is not None
        return f"the probability is {format_interval(decision.interval)}"
    low, high = decision.change_interval
    if math.isfinite(high):
        return f"{low:.2g} .. {high:.2g} times the baseline"
    return f"more than {low:.2g} times the baseline" if low else "the change is not known"


def _pool_results(
    target: CheckTarget, state: _CheckState, decisions: Sequence[Decision]
) -> tuple[Result, ...]:
    verdicts: dict[str, list[str]] = {}
    for decision in decisions:
        if decision.scenario == target.name and decision.kind == "threshold":
            verdicts.setdefault(decision.specification, []).append(decision.verdict)
    return tuple(
        replace(
            pool(state.batches[target.name, name], target.definition.max_error_rate),
            verdict=worst_verdict(verdicts.get(name, ())),
        )
        for name in target.definition.estimated
    )


def _try_to_save(target: CheckTarget, results: Sequence[Result]) -> tuple[Path | None, str]:
    try:
        path = baseline.save(target.folder, target.definition, results, target.firsts)
    except UsageError as error:  # a full disk must not cost the verdicts
        return None, f"NOT saved: {error.message}"
    return path, f"saved as baseline {path}; commit it"


def _decide_without_baseline(
    target: CheckTarget, result: Result, path: Path | None, obstacle: str
) -> Decision:
    if path is not None:
        verdict, reason = "pass", "nothing to compare with yet: saved as the first baseline"
        if result.health:
            verdict, reason = (
                "inconclusive",
                f"saved, with health warnings: {'; '.join(describe_health(result))}",
            )
    elif target.baseline is None:
        if result.health:
            cause = f"health warnings: {'; '.join(describe_health(result))}"
        elif result.verdict == "fail":
            cause = "it fails a threshold"
        else:
            cause = "another specification of this scenario is unhealthy or fails"
        verdict, reason = "inconclusive", f"no baseline, and none was saved: {obstacle or cause}"
    else:
        verdict, reason = "inconclusive", "the baseline lacks this specification: save a new one"
    return Decision(
        target.name,
        result.specification,
        "regression",
        "baseline",
        verdict,
        reason,
        result.probability,
        result.interval,
        rollouts=result.rollouts,
        seconds=result.seconds,
    )
