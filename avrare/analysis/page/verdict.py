"""First lines of a report: whether each threshold holds, in words, and how often a rule is broken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import get_args

from avrare.analysis.page.model import Answer, Estimate, Limit, Summary
from avrare.analysis.rates.combination import Interval, Quantity, combine, from_exposure
from avrare.base.number_format import format_amount_in_words, format_percent
from avrare.estimation.result.verdict import Verdict, worst_verdict
from avrare.scenario.exposure import Exposure

_FREQUENT = 0.1  # a smaller probability is written as one in so many


def build_summary(estimates: Sequence[Estimate], exposure: Exposure | None) -> Summary:
    """Return the overall verdict and a sentence for each specification; ``exposure`` gives rates."""
    judged = [estimate for estimate in estimates if estimate.verdict]
    example = f'thresholds: [{{specification: {estimates[0].specification}, probability: "< 1e-3"}}]'
    met = None if exposure is None else from_exposure(exposure, estimates[0].confidence)
    return Summary(
        worst_verdict(estimate.verdict for estimate in estimates),
        _summarise(judged),
        "" if judged else example,
        tuple(
            _build_answer(index, estimate, exposure)
            for index, estimate in sorted(enumerate(estimates), key=lambda entry: _grade(entry[1]))
        ),
        "" if exposure is None or met is None else _describe_exposure(exposure, met),
    )


def _grade(estimate: Estimate) -> tuple[int, float]:
    order = (*get_args(Verdict), None)
    return order.index(estimate.verdict), -estimate.probability


def _summarise(judged: Sequence[Estimate]) -> str:
    # One of several thresholds of a rule decides: its worst verdict is stored.
    if not judged:
        return "No threshold is set, so there is no verdict: this is how often each rule was broken."
    many = len(judged)
    verdicts = Counter(estimate.verdict for estimate in judged)
    assuming, exceeded = verdicts["pass_assuming"], verdicts["fail"]
    holding = verdicts["pass"] + assuming
    if holding == many:
        lead = "The threshold holds" if many == 1 else f"All {many} thresholds hold"
        return f"{lead}{_say_assuming(assuming, holding)}."
    clauses = [f"{holding} of {many} thresholds hold{_say_assuming(assuming, holding)}" if many > 1 else ""]
    if exceeded:
        clauses.append(
            f"{exceeded} {'are' if exceeded > 1 else 'is'} exceeded"
            if many > 1
            else "The threshold is exceeded"
        )
    if rest := many - holding - exceeded:
        clauses.append(
            f"{rest} {'are' if rest > 1 else 'is'} undecided" if many > 1 else "The threshold is undecided"
        )
    return ", ".join(clause for clause in clauses if clause) + "."


def _say_assuming(assuming: int, holding: int) -> str:
    if not assuming:
        return ""
    return f"{f', {assuming} of them' if holding > assuming else ''} as far as the search could see"


def _build_answer(index: int, estimate: Estimate, exposure: Exposure | None) -> Answer:
    rates = []
    if exposure is not None:
        probability = Quantity(estimate.probability, *estimate.interval)
        total = combine([from_exposure(exposure, estimate.confidence)], [probability])
        rates.append(f"{_say_rate(exposure.unit, total.value, total.interval)}.")
    return Answer(index, f"{_say_estimate(estimate)}{_say_limits(estimate)}.", tuple(rates))


def _say_estimate(estimate: Estimate) -> str:
    low, high = estimate.interval
    level = f"{format_percent(estimate.confidence)} confidence"
    if not estimate.probability:
        return f"never broken in {estimate.rollouts:,} rollouts, so in at most {say_share(high)} ({level})"
    rollouts = " of all rollouts" if estimate.probability >= _FREQUENT else " rollouts"
    ends = f"at most {say_share(high)}" if low <= 0.0 else f"{say_share(low)} to {say_share(high)}"
    return f"broken in {say_share(estimate.probability)}{rollouts} ({ends}, {level})"


def say_share(probability: float) -> str:
    """Return a probability as ``35 %`` or ``1 in 430``."""
    if probability <= 0.0:
        return "none"
    if probability >= _FREQUENT:
        return format_percent(float(f"{probability:.2g}"))
    return f"1 in {format_amount_in_words(1.0 / probability)}"


def _say_limits(estimate: Estimate) -> str:
    if not estimate.limits or estimate.verdict is None:
        return ""
    bounds = " and ".join(map(_say_limit, estimate.limits))
    said = {
        "pass": f"; allowed is {bounds}: it holds",
        "pass_assuming": f"; allowed is {bounds}: it holds as far as the search could see, and failures that "
        f"nothing led to could be up to {say_share(estimate.blind_bound or 0.0)}",
        "fail": f"; allowed is {bounds}: it does not hold",
        "inconclusive": f"; allowed is {bounds}: undecided, more rollouts are needed",
    }
    return said[estimate.verdict]


def _say_limit(limit: Limit) -> str:
    return f"{'less than' if limit.strict else 'at most'} {say_share(limit.limit)}"


def _say_rate(unit: str, value: float, interval: Interval) -> str:
    low, high = interval
    noun = "hours" if unit == "hour" else "km"
    rarest = f"to {format_amount_in_words(1.0 / low)} {noun}" if low > 0.0 else f"{noun} or more"
    if not value:
        return f"On the road: less than once in {format_amount_in_words(1.0 / high)} {noun}"
    often = f"once in {format_amount_in_words(1.0 / value)} {noun}"
    return f"On the road: {often} ({format_amount_in_words(1.0 / high)} {rarest})"


def _describe_exposure(exposure: Exposure, met: Quantity) -> str:
    source = f"counted {exposure.count:,} times" if exposure.count is not None else "as the scenario says"
    often = f"{met.value:.3g} times per {exposure.unit}"
    often += f" ({met.low:.2g} – {met.high:.2g})" if met.low < met.high else ""
    return f"This scene is met {often}, {source}."
