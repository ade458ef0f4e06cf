"""Model of the page of a run: built once, drawn by any renderer."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import get_args

from avrare.analysis.page.causes import build_causes, summarise_causes
from avrare.analysis.page.model import (
    Answer,
    Estimate,
    Limit,
    Notice,
    Origin,
    ReportModel,
    Rule,
    Section,
    Summary,
)
from avrare.analysis.page.player import build_player
from avrare.analysis.page.stored_rollouts import replay_rollouts
from avrare.analysis.rates.combination import Interval, Quantity, combine, from_exposure
from avrare.base.chart import Chart, Scale, make_log_scale
from avrare.base.number_format import format_amount_in_words, format_percent
from avrare.estimation.result.result import COLUMNS, Result
from avrare.estimation.result.verdict import Verdict, worst_verdict
from avrare.logic.syntax.printer import to_words
from avrare.plugin.registry import default_registry
from avrare.results.run import Run
from avrare.results.stored_causes import StoredCauses, read_causes
from avrare.scenario.exposure import Exposure

_FREQUENT = 0.1
"""A smaller probability is written as one in so many."""


def build_report(run: Run) -> ReportModel:
    """Return everything that the page of a run shows; its stored rollouts are replayed."""
    estimates = [_build_estimate(run, result) for result in run.values()]
    stored = read_causes(run.folder, {name: result.probability for name, result in run.items()})
    definition = run.definition
    return ReportModel(
        run.name,
        run.versions.get("avrare", ""),
        "" if definition is None else definition.description or "",
        _list_facts(run),
        _build_summary(estimates, stored, None if definition is None else definition.exposure),
        _make_axis(estimates),
        tuple(_list_notices(run)),
        _build_sections(run, estimates, stored),
        _build_origin(run),
    )


def _list_facts(run: Run) -> tuple[str, ...]:
    estimators = ", ".join(dict.fromkeys(result.estimator for result in run.values()))
    facts = [f"estimator {estimators}", f"seed {run.seed}", f"{run.date:%d %B %Y, %H:%M} UTC"]
    commit = run.provenance.commit
    return (*facts, f"commit {commit[:10]}") if commit else tuple(facts)


def _build_estimate(run: Run, result: Result) -> Estimate:
    limits = run.thresholds(result.specification)
    return Estimate(
        result.specification,
        result.verdict,
        result.probability,
        result.interval,
        result.confidence,
        result.relative_error if math.isfinite(result.relative_error) else None,
        result.rollouts,
        tuple((column.name, column.count(result)) for column in COLUMNS),
        result.seconds,
        tuple(Limit(threshold.strict, threshold.limit) for threshold in limits),
        tuple(result.health.items()),
        tuple(note.text for note in result.notes),
        result.blind_bound,
        None if run.build_errors or run.problem.dt is None else run.problem.steps * run.problem.dt,
    )


def _make_axis(estimates: Sequence[Estimate]) -> Scale:
    # An interval from 0 gets a decade of its own.
    values: list[float] = []
    for estimate in estimates:
        low, high = estimate.interval
        values += [low, high, estimate.probability, *(limit.limit for limit in estimate.limits)]
        values += [high / 10.0] if low <= 0.0 else []
    return make_log_scale(values, most=1.0)


def _list_notices(run: Run) -> list[Notice]:
    notices = []
    if run.build_errors:
        text = "The scenario of this run cannot be built here, so everything that needs it is missing:"
        notices.append(Notice(text, run.build_errors))
    if run.changes:
        notices.append(Notice("The scenario shown may differ from the scenario that was run:", run.changes))
    return notices


def _build_origin(run: Run) -> Origin:
    provenance = run.provenance
    commit, command = provenance.commit, provenance.command
    changed = " with uncommitted changes" if provenance.uncommitted_changes else ""
    facts = [("fingerprint", run.fingerprint, True)] if run.fingerprint else []
    facts += [
        ("commit", f"{commit}{changed}" if commit else "none", bool(commit)),
        ("Python", provenance.python or "–", False),
        ("budget", provenance.budget or "the estimator's own options", False),
        *((name, version, False) for name, version in run.versions.items()),
    ]
    return Origin(
        run.reproduction,
        shlex.join([Path(command[0]).name, *command[1:]]) if command else "",
        "" if run.folder is None else shlex.join(["avrare", "report", str(run.folder)]),
        tuple(facts),
        run.scenario_text,
    )


def _build_summary(estimates: Sequence[Estimate], stored: StoredCauses, exposure: Exposure | None) -> Summary:
    """Return the overall verdict and a sentence for each specification; ``exposure`` gives rates."""
    judged = [estimate for estimate in estimates if estimate.verdict]
    example = f'thresholds: [{{specification: {estimates[0].specification}, probability: "< 1e-3"}}]'
    frequency = None if exposure is None else from_exposure(exposure, estimates[0].confidence)
    return Summary(
        worst_verdict(estimate.verdict for estimate in estimates),
        _summarise(judged),
        "" if judged else example,
        tuple(
            _build_answer(index, estimate, stored, exposure)
            for index, estimate in sorted(enumerate(estimates), key=lambda entry: _grade(entry[1]))
        ),
        "" if exposure is None or frequency is None else _describe_exposure(exposure, frequency),
    )


def _grade(estimate: Estimate) -> tuple[int, float]:
    order = (*get_args(Verdict), None)
    return order.index(estimate.verdict), -estimate.probability


def _summarise(judged: Sequence[Estimate]) -> str:
    # One of several thresholds of a rule decides: its worst verdict is stored.
    if not judged:
        return "No threshold is set, so there is no verdict: this is how often each rule was broken."
    total = len(judged)
    verdicts = Counter(estimate.verdict for estimate in judged)
    assuming, exceeded = verdicts["pass_assuming"], verdicts["fail"]
    holding = verdicts["pass"] + assuming
    if holding == total:
        lead = "The threshold holds" if total == 1 else f"All {total} thresholds hold"
        return f"{lead}{_describe_assuming(assuming, holding)}."
    clauses = [
        f"{holding} of {total} thresholds hold{_describe_assuming(assuming, holding)}" if total > 1 else ""
    ]
    if exceeded:
        clauses.append(
            f"{exceeded} {'are' if exceeded > 1 else 'is'} exceeded"
            if total > 1
            else "The threshold is exceeded"
        )
    if rest := total - holding - exceeded:
        clauses.append(
            f"{rest} {'are' if rest > 1 else 'is'} undecided" if total > 1 else "The threshold is undecided"
        )
    return ", ".join(clause for clause in clauses if clause) + "."


def _describe_assuming(assuming: int, holding: int) -> str:
    if not assuming:
        return ""
    return f"{f', {assuming} of them' if holding > assuming else ''} as far as the search could see"


def _build_answer(index: int, estimate: Estimate, stored: StoredCauses, exposure: Exposure | None) -> Answer:
    rates = []
    if exposure is not None:
        probability = Quantity(estimate.probability, *estimate.interval)
        total = combine([from_exposure(exposure, estimate.confidence)], [probability])
        rates.append(f"{_describe_rate(exposure.unit, total.value, total.interval)}.")
    reasons = summarise_causes(estimate.specification, stored) if estimate.probability else []
    if estimate.blind_bound and estimate.verdict != "pass_assuming":
        reasons.append(
            f"Failures that nothing led to could be up to {_describe_share(estimate.blind_bound)}."
        )
    return Answer(
        index, f"{_describe_estimate(estimate)}{_describe_limits(estimate)}.", tuple(rates), tuple(reasons)
    )


def _describe_estimate(estimate: Estimate) -> str:
    low, high = estimate.interval
    level = f"{format_percent(estimate.confidence)} confidence"
    length = "" if estimate.duration is None else f" of {estimate.duration:g} s"
    if not estimate.probability:
        count = f"{estimate.rollouts:,} rollouts{length}"
        return f"never broken in {count}, so in at most {_describe_share(high)} ({level})"
    rollouts = f"{' of all' * (estimate.probability >= _FREQUENT)} rollouts{length}"
    ends = (
        f"at most {_describe_share(high)}"
        if low <= 0.0
        else f"{_describe_share(low)} to {_describe_share(high)}"
    )
    return f"broken in {_describe_share(estimate.probability)}{rollouts} ({ends}, {level})"


def _describe_share(probability: float) -> str:
    # 35 % or 1 in 430
    if probability <= 0.0:
        return "none"
    if probability >= _FREQUENT:
        return format_percent(float(f"{probability:.2g}"))
    return f"1 in {format_amount_in_words(1.0 / probability)}"


def _describe_limits(estimate: Estimate) -> str:
    if not estimate.limits or estimate.verdict is None:
        return ""
    bounds = " and ".join(map(_describe_limit, estimate.limits))
    undecided = "for a warning doubts it" if estimate.warnings else "more rollouts are needed"
    said = {
        "pass": f"; allowed is {bounds}: it holds",
        "pass_assuming": f"; allowed is {bounds}: it holds as far as the search could see, and failures that "
        f"nothing led to could be up to {_describe_share(estimate.blind_bound or 0.0)}",
        "fail": f"; allowed is {bounds}: it does not hold",
        "inconclusive": f"; allowed is {bounds}: undecided, {undecided}",
    }
    return said[estimate.verdict]


def _describe_limit(limit: Limit) -> str:
    return f"{'less than' if limit.strict else 'at most'} {_describe_share(limit.limit)}"


def _describe_rate(unit: str, value: float, interval: Interval) -> str:
    low, high = interval
    noun = "hours" if unit == "hour" else "km"
    rarest = f"to {format_amount_in_words(1.0 / low)} {noun}" if low > 0.0 else f"{noun} or more"
    if not value:
        return f"On the road: less than once in {format_amount_in_words(1.0 / high)} {noun}"
    often = f"once in {format_amount_in_words(1.0 / value)} {noun}"
    return f"On the road: {often} ({format_amount_in_words(1.0 / high)} {rarest})"


def _describe_exposure(exposure: Exposure, met: Quantity) -> str:
    source = f"counted {exposure.total:,} times" if exposure.total is not None else "as the scenario says"
    often = f"{met.value:.3g} times per {exposure.unit}"
    often += f" ({met.low:.2g} – {met.high:.2g})" if met.low < met.high else ""
    return f"This scene is met {often}, {source}."


def _build_sections(run: Run, estimates: Sequence[Estimate], stored: StoredCauses) -> tuple[Section, ...]:
    """Return a section for each estimate of a run."""
    rollouts, errors = replay_rollouts(run, stored.kinds)
    sections = []
    for estimate in estimates:
        name = estimate.specification
        result, replays = run[name], rollouts.get(name, [])
        section = Section(
            estimate,
            _build_rule(run, name),
            build_causes(run, result, stored, replays),
            _draw_charts(result),
            tuple(build_player(rollout, run.problem, run.folder) for rollout in replays),
            None if replays else _explain_absence(run, errors if name in rollouts else ()),
        )
        sections.append(section)
    return tuple(sections)


def _build_rule(run: Run, name: str) -> Rule | None:
    if run.build_errors or name not in run.problem.names:
        return None
    specification = run.problem.monitor(name)
    formula, words = specification.formula, specification.words
    if formula is not None and not words:
        words = to_words(formula.node, float(formula.period))
    text = "" if formula is None else formula.text.strip()
    return Rule("" if len(words) > 400 else words, text)  # longer words say less than the formula


def _draw_charts(result: Result) -> tuple[Chart, ...]:
    draw: Callable[[Result], tuple[Chart, ...]] = resolve_name(default_registry().charts(result.estimator))
    return draw(result)


def _explain_absence(run: Run, errors: Sequence[str]) -> Notice:
    if run.build_errors:
        return Notice("The stored rollouts are not shown: the scenario cannot be built here.")
    if errors:
        return Notice("The stored rollouts could not be replayed:", tuple(errors))
    return Notice("No rollout is stored in the run folder.")
