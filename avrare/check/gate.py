"""A whole check: draw, look, decide, and go on where that was asked for and something is still open."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from avrare.check import baseline
from avrare.check.claims import Claim, Row, look, row
from avrare.check.looks import Stage
from avrare.check.pooling import pooled
from avrare.check.subjects import Machine, Subject, estimate
from avrare.check.verdicts import doubts, settle
from avrare.errors import ExitCode, UsageError
from avrare.estimation.result import Result
from avrare.record import rundir
from avrare.report.console import number

SCHEMA = 1


@dataclass(frozen=True)
class Outcome:
    """What a check found.

    Attributes:
        rows: One for each claim, and for each rule that had no baseline.
        results: Scenario -> its estimates, verdicts of the thresholds included.
        notes: What to know when reading it.
        looks: How often was looked.
    """

    rows: tuple[Row, ...]
    results: dict[str, tuple[Result, ...]]
    notes: tuple[str, ...] = ()
    looks: int = 1

    @property
    def exit_code(self) -> ExitCode:
        """Broken rollouts first: verdicts on them mean little. Then the worst verdict."""
        if any("errors" in one.health for results in self.results.values() for one in results):
            return ExitCode.ROLLOUT_ERRORS
        verdicts = {one.verdict for one in self.rows}
        if "fail" in verdicts:
            return ExitCode.FAIL
        return ExitCode.INCONCLUSIVE if "inconclusive" in verdicts else ExitCode.PASS

    @property
    def verdict(self) -> str:
        """Of the whole: "pass", "fail" or "inconclusive"."""
        return worst(one.verdict for one in self.rows) or "pass"

    def broken(self, row: Row) -> bool:
        """Whether more rollouts than allowed broke down in the estimate of a row."""
        return any(
            "errors" in one.health
            for one in self.results.get(row.scenario, ())
            if one.specification == row.specification
        )

    def to_dict(self, subjects: Sequence[Subject]) -> dict[str, Any]:
        """The content of check.json."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "exit_code": int(self.exit_code),
            "looks": self.looks,
            "rows": [one.to_dict() for one in self.rows],
            "notes": list(self.notes),
            "results": [
                rundir.document(one.definition, self.results[one.definition.name]) for one in subjects
            ],
        }


def worst(verdicts: Iterable[str]) -> str | None:
    """The worst of some verdicts, None of none."""
    found = set(verdicts)
    return next((name for name in ("fail", "inconclusive", "pass") if name in found), None)


@dataclass
class _Progress:
    """What is known so far; batches by scenario and rule, verdicts by number of the claim."""

    claims: list[Claim]
    verdicts: dict[int, str] = field(default_factory=dict)
    batches: dict[tuple[str, str], list[Result]] = field(default_factory=dict)
    looks: int = 0

    def open_rules(self, one: Subject, save: bool) -> list[str]:
        """Rules of a scenario that another look would help; all at the first, or if they will be saved.

        To save what was stopped once it pleased would make a biased baseline.
        """
        rules = one.definition.estimated
        if not self.looks or save or (one.compared and one.baseline is None):
            return list(rules)
        asked = {
            claim.specification
            for index, claim in enumerate(self.claims)
            if index not in self.verdicts and claim.scenario == one.definition.name
        }
        return [rule for rule in rules if rule in asked]


def check(subjects: Sequence[Subject], stages: Sequence[Stage], machine: Machine, save: bool) -> Outcome:
    """Decide, and save the baselines that are missing or asked for; arguments as of ``decide``."""
    return _saved(decide(subjects, stages, machine, save), subjects, save)


def decide(
    subjects: Sequence[Subject], stages: Sequence[Stage], machine: Machine, save: bool = False
) -> Outcome:
    """The verdicts on scenarios that are checked together: their claims share one error rate.

    Args:
        subjects: The scenarios.
        stages: The looks.
        machine: Where estimates run.
        save: The results will be saved: stop at no look, so that they are worth it.

    Raises:
        UsageError: An estimator cannot take the problem or the budget.
    """
    progress = _Progress([claim for one in subjects for claim in one.claims])
    rates = {one.definition.name: one.definition.max_error_rate for one in subjects}

    def result(claim: Claim) -> Result | None:
        batches = progress.batches.get((claim.scenario, claim.specification))
        return pooled(batches, rates[claim.scenario]) if batches else None

    for stage in stages:
        work = [(one, rules) for one in subjects if (rules := progress.open_rules(one, save))]
        if not work:
            break
        for one, rules in work:
            for found in _estimates(one, rules, stage, machine):
                progress.batches.setdefault((one.definition.name, found.specification), []).append(found)
        progress.verdicts = settle(progress.claims, result, stage.share, progress.verdicts)
        progress.looks += 1
    rows = [_row(progress, index, claim, result(claim)) for index, claim in enumerate(progress.claims)]
    results = {one.definition.name: _results(one, progress, rows) for one in subjects}
    return Outcome(tuple(rows), results, looks=progress.looks)


def _estimates(one: Subject, rules: list[str], stage: Stage, machine: Machine) -> list[Result]:
    try:
        return estimate(one.scenario, rules, stage, machine)
    except UsageError as error:
        if stage.share == 1.0 or "does not pay" not in error.message:
            raise
        hint = f"--spend is divided into looks; the first has {stage.share:g} of it"
        raise UsageError(error.message, hint) from None


def _row(progress: _Progress, index: int, claim: Claim, result: Result | None) -> Row:
    verdict = progress.verdicts.get(index, "inconclusive")
    if result is None:
        return row(claim, verdict, "not estimated: estimator.specifications leaves it out", None)
    made = row(claim, verdict, "", result)
    return replace(made, reason=_reason(claim, made, result, len(progress.claims)))


def _reason(claim: Claim, made: Row, result: Result, many: int) -> str:
    """Why it did not pass, or that it did for want of failures; empty where the numbers say it all."""
    if made.verdict == "pass":
        nothing = claim.baseline is not None and made.probability == made.baseline == 0.0
        return "nothing failed, then or now: no ratio can be told" if nothing else ""
    doubted = doubts(claim, result)
    span = _span(made)
    if made.verdict == "fail":
        return "; ".join([span, *doubted])
    if doubted:
        return "; ".join(doubted)
    if look(claim, result, 1.0).blame <= 1.0:
        return f"{span}: it would fail alone and at once, but not as one of {many} claims or several looks"
    return f"{span}: use more simulations"


def _span(made: Row) -> str:
    """Between what the answer lies, in words."""
    if made.change_interval is None:
        assert made.interval is not None
        low, high = made.interval
        return f"the probability is {number(low, 2)} .. {number(high, 2)}"
    low, high = made.change_interval
    if math.isfinite(high):
        return f"{low:.2g} .. {high:.2g} times the baseline"
    return f"more than {low:.2g} times the baseline" if low else "neither tells anything of the ratio"


def _results(one: Subject, progress: _Progress, rows: Sequence[Row]) -> tuple[Result, ...]:
    """Of all rules, with the verdicts of their thresholds."""
    name, found = one.definition.name, []
    for rule in one.definition.estimated:
        verdict = worst(
            made.verdict
            for made in rows
            if (made.scenario, made.specification, made.kind) == (name, rule, "threshold")
        )
        whole = pooled(progress.batches[name, rule], one.definition.max_error_rate)
        found.append(replace(whole, verdict=verdict))
    return tuple(found)


def _saved(outcome: Outcome, subjects: Sequence[Subject], save: bool) -> Outcome:
    """With baselines saved, the first by itself, others on demand, and rows for what had none."""
    rows, notes = list(outcome.rows), []
    for one in subjects:
        results = outcome.results[one.definition.name]
        notes += [f"{one.definition.name}: {note}" for note in one.notes]
        if not one.compared:
            continue
        first = one.baseline is None
        sound = not any(result.health or result.verdict == "fail" for result in results)
        path, why_not = None, "unsound ({})"
        if save or (first and sound):
            path, note = _try_to_save(one, results)
            notes.append(f"{one.definition.name}: {note}")
            why_not = "it could not be"
        rows += [_unmatched(one, result, path, why_not) for result in results if not _known(one, result)]
    order = {one.definition.name: index for index, one in enumerate(subjects)}
    rows.sort(key=lambda made: order[made.scenario])
    return replace(outcome, rows=tuple(rows), notes=tuple(notes))


def _try_to_save(one: Subject, results: Sequence[Result]) -> tuple[Path | None, str]:
    """A verdict that took a night is not lost because a disk is full: the failure is told beside it."""
    try:
        path = baseline.save(one.folder, one.definition, results)
    except UsageError as error:
        return None, f"NOT saved: {error.message}"
    return path, f"saved as baseline {path}; commit it"


def _known(one: Subject, result: Result) -> bool:
    return one.baseline is not None and result.specification in one.baseline.entries


def _unmatched(one: Subject, result: Result, path: Path | None, why_not: str) -> Row:
    """The row of a rule that there is nothing to compare with; ``why_not`` it is saved, where it is not."""
    if path is not None:
        verdict, reason = "pass", "nothing to compare with yet: saved as the first baseline"
    elif one.baseline is None:
        own = "it fails a threshold" if result.verdict == "fail" else "another rule of this scenario is"
        names = ", ".join(result.health) or own
        verdict, reason = (
            "inconclusive",
            f"no baseline, and this is not saved as one: {why_not.format(names)}",
        )
    else:
        verdict, reason = "inconclusive", "the baseline does not have this rule: --save makes a new one"
    if path is not None and result.health:
        verdict, reason = "inconclusive", f"saved, but warned of {', '.join(result.health)}"
    return Row(
        one.definition.name, result.specification, "regression", "baseline", verdict, reason,
        result.probability, result.interval, rollouts=result.rollouts, seconds=result.seconds,
    )  # fmt: skip
