"""Claims of a pack: each with its measure, its evidence, and its challenges."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from avrare.base.number_format import format_interval, format_percent, format_probability
from avrare.estimation.result.result import Result
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
        measure: Rule, value, interval, bound, verdict.
        challenges: What speaks against it.
    """

    text: str
    source: Source
    file: str
    measure: Mapping[str, Any]
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
    """Return the claims of a source: one for each bound, or for a rule without any."""
    if "rules" in source.summary:
        return [claim for rule in source.summary["rules"] for claim in _claim_rates(source, rule)]
    return [
        _claim_probability(source, place, run, result, question, verdict)
        for place, run in source.runs.items()
        for result in run.values()
        for question, verdict in _list_questions(source, run, result)
    ]


def _list_questions(source: Source, run: Run, result: Result) -> list[tuple[str | None, str | None]]:
    if source.summary:
        name = (run.name, result.specification)
        rows = [row for row in source.summary["rows"] if (row["scenario"], row["specification"]) == name]
        return [(row["question"], row["verdict"]) for row in rows if row["question"] != "baseline"] or [
            (None, None)
        ]
    bounds = run.thresholds(result.specification)
    return [(str(bound.probability), result.verdict) for bound in bounds] or [(None, None)]


def _claim_probability(
    source: Source, place: str, run: Run, result: Result, question: str | None, verdict: str | None
) -> Claim:
    bound = question or f"at most {format_probability(result.interval[1])}"
    subject = f"{run.name}: the probability that a drive breaks {result.specification}"
    measure = _measure(result.specification, result.probability, result.interval, question, verdict)
    challenges = (*_challenge_verdict(measure, bool(result.health)), *_challenge_result(result, verdict))
    text = f"{subject} is {bound}, at {format_percent(result.confidence)}"
    return Claim(text, source, f"{source.home}{place}{RESULT}", measure, challenges)


def _claim_rates(source: Source, rule: Mapping[str, Any]) -> Iterator[Claim]:
    level = format_percent(source.summary["confidence"])
    for threshold in rule["thresholds"] or [{"bound": None, "verdict": None}]:
        bound, verdict = threshold["bound"], threshold["verdict"]
        unit = f"per_{bound.split()[-1]}" if bound else next(key for key in rule if key.startswith("per_"))
        total, words = rule[unit], unit.replace("_", " ")
        measure = _measure(rule["rule"], total["value"], total["interval"], bound, verdict) | {"unit": words}
        warnings = [
            (scene["name"], message)
            for scene in source.summary["scenes"]
            for message in scene.get("warnings", {}).get(rule["rule"], {}).values()
        ]
        challenges = [*_challenge_verdict(measure, bool(warnings))]
        if (blind := rule.get(f"blind_bound_{unit}")) is not None:
            challenges.append(_challenge_blind(f"{format_probability(blind)} {words}", verdict))
        undecided = verdict == "inconclusive"
        challenges += [Challenge(f"Scene {name}: {text}", "warnings", undecided) for name, text in warnings]
        asked = bound or f"at most {format_probability(total['interval'][1])} {words}"
        text = f"{source.name}: the rate of drives that break {rule['rule']} is {asked}, at {level}"
        yield Claim(text, source, source.home + source.file, measure, tuple(challenges))


def _measure(
    rule: str, value: float, interval: tuple[float, float], bound: str | None, verdict: str | None
) -> dict[str, Any]:
    low, high = interval
    return {"rule": rule, "value": value, "low": low, "high": high, "bound": bound, "verdict": verdict}


def _challenge_verdict(measure: Mapping[str, Any], is_warned: bool) -> Iterator[Challenge]:
    numbers = format_interval((measure["low"], measure["high"]))
    if measure["verdict"] == "fail":
        yield Challenge(f"The interval {numbers} does not keep to {measure['bound']}", "interval", True)
    elif measure["verdict"] == "inconclusive" and not is_warned:
        yield Challenge(f"The interval {numbers} reaches past {measure['bound']}", "interval", True)


def _challenge_result(result: Result, verdict: str | None) -> Iterator[Challenge]:
    check = result.cross_check
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
