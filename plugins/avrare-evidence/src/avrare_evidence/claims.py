"""Claims of a pack: each with its measure, its evidence, and its challenges."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from avrare.base.errors import UsageError
from avrare.base.number_format import format_interval, format_percent, format_probability
from avrare.estimation.result.result import Result
from avrare.estimation.result.verdict import with_verdict
from avrare.results.run import RESULT, Run
from avrare_evidence.sources import Source

_STATES = {
    "pass": "holds",
    "pass_assuming": "holds as far as the search could see",
    "inconclusive": "not shown",
    "fail": "refuted",
    None: "measured, no bound asked",
}
"""Verdict -> state of a claim."""
Measure: TypeAlias = "dict[str, Any]"
"""Rule, value, interval, unit, bound and verdict of a claim; the last two are None where no bound is set."""


@dataclass(frozen=True)
class Challenge:
    """Reason to doubt a claim.

    Attributes:
        text: The reason.
        place: Key in the claim's file with the evidence for it.
        decides: Whether the verdict would be another without it.
        answer: Reason against the challenge; empty where there is none.
    """

    text: str
    place: str
    decides: bool = False
    answer: str = ""


@dataclass(frozen=True)
class Claim:
    """Statement about one rule.

    Attributes:
        text: The statement.
        source: Source that it rests on.
        file: File of the pack that supports it.
        measure: Its numbers.
        challenges: What speaks against it.
    """

    text: str
    source: Source
    file: str
    measure: Measure
    challenges: tuple[Challenge, ...]

    @property
    def state(self) -> str:
        """State in words."""
        return _STATES[self.measure["verdict"]]

    @property
    def is_defeated(self) -> bool:
        """Whether a challenge decides the verdict."""
        return any(challenge.decides for challenge in self.challenges)


def list_claims(source: Source) -> list[Claim]:
    """Return the claims of a source: one for each bound, or for a rule without any.

    Raises:
        UsageError: Its file with the verdicts is damaged.
    """
    try:
        if "rules" in source.summary:
            return [*_claim_rates(source), *_claim_balances(source)]
        return [
            _claim_probability(source, place, run, result, measure)
            for place, run in source.runs.items()
            for result in run.values()
            for measure in _measure_result(source, run, result)
        ]
    except (KeyError, TypeError, AttributeError, StopIteration) as error:
        text = f"{source.folder / source.file}: it is damaged ({type(error).__name__}: {error})"
        raise UsageError(text, "run it again") from None


def _measure_result(source: Source, run: Run, result: Result) -> list[Measure]:
    name, bounds = result.specification, run.thresholds(result.specification)
    if not source.summary:
        verdicts = [(str(bound.probability), with_verdict(result, [bound]).verdict) for bound in bounds]
        measures = [_measure(name, result.probability, result.interval, *verdict) for verdict in verdicts]
    else:
        measures = [
            _measure(name, row["change"], row["change_interval"], row["question"], row["verdict"], "times")
            if row["kind"] == "regression"
            else _measure(name, row["probability"], row["interval"], row["question"], row["verdict"])
            for row in source.summary["rows"]
            if (row["scenario"], row["specification"]) == (run.name, name) and row["question"] != "baseline"
        ]
    return measures or [_measure(name, result.probability, result.interval)]


def _claim_probability(source: Source, place: str, run: Run, result: Result, measure: Measure) -> Claim:
    bound = measure["bound"] or f"at most {format_probability(result.interval[1])}"
    text = f"{run.name}: the probability that a drive breaks {result.specification} is {bound}"
    challenges = (*_challenge_verdict(measure, bool(result.health)), *_challenge_result(result, measure))
    level = format_percent(result.confidence)
    return Claim(f"{text}, at {level}", source, f"{source.home}{place}{RESULT}", measure, challenges)


def _claim_rates(source: Source) -> Iterator[Claim]:
    level = format_percent(source.summary["confidence"])
    for rule in source.summary["rules"]:
        for threshold in rule["thresholds"] or [{"bound": None, "verdict": None}]:
            bound, verdict = threshold["bound"], threshold["verdict"]
            unit = (
                f"per_{bound.split()[-1]}" if bound else next(key for key in rule if key.startswith("per_"))
            )
            total, words = rule[unit], unit.replace("_", " ")
            measure = _measure(rule["rule"], total["value"], total["interval"], bound, verdict, words)
            warnings = [*_challenge_scenes(source.summary["scenes"], measure)]
            challenges = [*_challenge_verdict(measure, bool(warnings)), *warnings]
            if (blind := rule.get(f"blind_bound_{unit}")) is not None:
                challenges.append(_challenge_blind(f"{format_probability(blind)} {words}", verdict))
            asked = bound or f"at most {format_probability(measure['high'])} {words}"
            text = f"{source.name}: the rate of drives that break {rule['rule']} is {asked}, at {level}"
            yield Claim(text, source, source.home + source.file, measure, tuple(challenges))


def _claim_balances(source: Source) -> Iterator[Claim]:
    """Claim that the stack breaks each rule less often than the reference driver of the catalogue."""
    verdicts = {"positive": "pass", "negative": "fail"}
    reference = source.summary.get("reference", {"balances": ()})
    for balance in reference["balances"]:
        verdict = verdicts.get(balance["verdict"], "inconclusive")
        numbers = (balance["ratio"], balance["interval"], "less often", verdict, "times as often")
        measure = _measure(balance["rule"], *numbers)
        scenes = [*source.summary["scenes"], *reference["scenes"]]
        challenges = (*_challenge_verdict(measure, False), *_challenge_scenes(scenes, measure))
        text = f"{source.name}: the stack breaks {balance['rule']} less often than {reference['driver']}"
        yield Claim(text, source, source.home + source.file, measure, challenges)


def _measure(
    rule: str,
    value: float | None,
    interval: Sequence[float | None] | None,
    bound: str | None = None,
    verdict: str | None = None,
    unit: str = "",
) -> Measure:
    """Return the numbers of a claim; those that a file holds as null are unbounded or unknown."""
    low, high = interval or (None, None)
    measure = {"rule": rule, "value": value, "low": low or 0.0, "high": math.inf if high is None else high}
    return measure | {"unit": unit, "bound": bound, "verdict": verdict}


def _challenge_verdict(measure: Measure, is_warned: bool) -> Iterator[Challenge]:
    numbers = f"{format_interval((measure['low'], measure['high']))} {measure['unit']}".rstrip()
    if measure["verdict"] == "fail":
        yield Challenge(f"The interval {numbers} does not keep to {measure['bound']}", "interval", True)
    elif measure["verdict"] == "inconclusive" and not is_warned:
        yield Challenge(f"The interval {numbers} reaches past {measure['bound']}", "interval", True)


def _challenge_scenes(scenes: Sequence[Mapping[str, Any]], measure: Measure) -> Iterator[Challenge]:
    for scene in scenes:
        for message in scene.get("warnings", {}).get(measure["rule"], {}).values():
            text = f"Scene {scene['name']}: {message}"
            yield Challenge(text, "warnings", measure["verdict"] == "inconclusive")


def _challenge_result(result: Result, measure: Measure) -> Iterator[Challenge]:
    check, verdict = result.cross_check, measure["verdict"]
    for name, message in result.health.items():
        yield Challenge(f"Warning {name}: {message}", f"warnings.{name}", verdict == "inconclusive")
    if result.blind_bound is not None:
        agrees = check is not None and check.outcome == "agree"
        answer = f"A second estimate, by {check.estimator}, agrees" if check and agrees else ""
        yield _challenge_blind(format_probability(result.blind_bound), verdict, answer)
    if check is not None and check.outcome == "inconclusive":
        yield Challenge(f"The cross-check by {check.estimator} could not decide", "cross_check")
    if result.errors:
        text = f"{result.errors:,} of {result.rollouts:,} rollouts broke down; they count against both ends"
        yield Challenge(text, "errors")
    for note in result.notes:
        if note.kind in ("model", "goal"):
            yield Challenge(note.text, "notes")


def _challenge_blind(bound: str, verdict: str | None, answer: str = "") -> Challenge:
    text = f"Failures that the search is not led to could be as likely as {bound}"
    return Challenge(text, "blind_bound", verdict == "pass_assuming", answer)
