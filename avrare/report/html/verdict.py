"""First lines of a report: whether each threshold holds, in words, and how often a rule is broken."""

from __future__ import annotations

from collections.abc import Sequence

from avrare.analysis.rates.combination import Quantity, Total, combine, from_exposure
from avrare.base.number_format import format_amount_in_words, format_percent
from avrare.estimation.result import Result, worst_verdict
from avrare.report.html.markup import Markup, link_command, tag
from avrare.results.run import Run
from avrare.scenario.schema import Threshold

_VERDICTS = {"pass": "Passes", "fail": "Fails", "inconclusive": "Inconclusive", None: "No threshold"}
_SIGNS = {"pass": "✓", "fail": "✕", "inconclusive": "?", None: "–"}
_FREQUENT = 0.1  # a smaller probability is written as one in so many


def render_badge(verdict: str | None) -> Markup:
    """Return a verdict as a word with a sign, so that it does not depend on colour alone."""
    return tag("span", render_sign(verdict), f" {_VERDICTS[verdict]}", class_=f"badge {verdict or 'none'}")


def render_sign(verdict: str | None) -> Markup:
    """Return the sign of a verdict alone."""
    return tag("span", _SIGNS[verdict], aria_hidden="true")


def render_verdict(run: Run) -> Markup:
    """Return the section with the overall verdict and a sentence for each specification."""
    estimates = list(run.values())
    judged = [one for one in estimates if one.verdict]
    lines = [_render_line(run, one) for one in sorted(estimates, key=_by_gravity)]
    return tag(
        "section",
        tag("div", render_badge(worst_verdict(one.verdict for one in estimates)), class_="verdict"),
        tag("p", _summarise(judged), link_command("run"), class_="lead"),
        _render_hint(run) if not judged else None,
        tag("ul", lines, class_="answers"),
        _render_exposure(run),
        class_="summary", id="verdict", aria_label="Verdict",
    )  # fmt: skip


def _by_gravity(result: Result) -> tuple[int, float]:
    order = ("fail", "inconclusive", "pass", None)
    return order.index(result.verdict), -result.probability


def _summarise(judged: Sequence[Result]) -> str:
    # One of several thresholds of a rule decides: its worst verdict is stored.
    if not judged:
        return "No threshold is set, so there is no verdict: this is how often each rule was broken."
    many = len(judged)
    kept, broken = (sum(one.verdict == word for one in judged) for word in ("pass", "fail"))
    if kept == many:
        return "The threshold holds." if many == 1 else f"All {many} thresholds hold."
    parts = [f"{kept} of {many} thresholds hold" if many > 1 else ""]
    if broken:
        parts.append(
            f"{broken} {'are' if broken > 1 else 'is'} exceeded" if many > 1 else "The threshold is exceeded"
        )
    if rest := many - kept - broken:
        parts.append(
            f"{rest} {'are' if rest > 1 else 'is'} undecided" if many > 1 else "The threshold is undecided"
        )
    return ", ".join(part for part in parts if part) + "."


def _render_hint(run: Run) -> Markup:
    name = next(iter(run.values())).specification
    example = f'thresholds: [{{specification: {name}, probability: "< 1e-3"}}]'
    return tag("p", "To get one, add to the scenario, for example: ", tag("code", example), class_="muted")


def _render_line(run: Run, result: Result) -> Markup:
    index = list(run).index(result.specification)
    link = tag("a", result.specification, href=f"#specification-{index}")
    sign = tag("span", render_sign(result.verdict), class_=f"sign {result.verdict or 'none'}")
    said = f": {_say_estimate(result)}{_say_thresholds(result, run.thresholds(result.specification))}."
    rates = [tag("span", f" {_say_rate(unit, rate)}.") for unit, rate in compute_rates(run, result).items()]
    return tag("li", sign, tag("div", tag("strong", link), said, rates))


def _say_estimate(result: Result) -> str:
    low, high = result.interval
    level = f"{format_percent(result.confidence)} confidence"
    if not result.probability:
        return f"never broken in {result.rollouts:,} rollouts, so in at most {say_share(high)} ({level})"
    rollouts = " of all rollouts" if result.probability >= _FREQUENT else " rollouts"
    ends = f"at most {say_share(high)}" if low <= 0.0 else f"{say_share(low)} to {say_share(high)}"
    return f"broken in {say_share(result.probability)}{rollouts} ({ends}, {level})"


def say_share(probability: float) -> str:
    """Return a probability as ``35 %`` or ``1 in 430``."""
    if probability <= 0.0:
        return "none"
    if probability >= _FREQUENT:
        return format_percent(float(f"{probability:.2g}"))
    return f"1 in {format_amount_in_words(1.0 / probability)}"


def _say_thresholds(result: Result, thresholds: Sequence[Threshold]) -> str:
    if not thresholds or result.verdict is None:
        return ""
    bounds = " and ".join(
        f"{'less than' if one.strict else 'at most'} {say_share(one.limit)}" for one in thresholds
    )
    said = {
        "pass": f"; allowed is {bounds}: it holds",
        "fail": f"; allowed is {bounds}: it does not hold",
        "inconclusive": f"; allowed is {bounds}: undecided, more rollouts are needed",
    }
    return said[result.verdict]


def compute_rates(run: Run, result: Result) -> dict[str, Total]:
    """Return how often a rule is broken per hour or per km; empty where the exposure is not known."""
    exposure = None if run.definition is None else run.definition.exposure
    if exposure is None:
        return {}
    probability = Quantity(result.probability, *result.interval)
    return {exposure.unit: combine([from_exposure(exposure, result.confidence)], [probability])}


def _say_rate(unit: str, rate: Total) -> str:
    low, high = rate.interval
    noun = "hours" if unit == "hour" else "km"
    rarest = f"to {format_amount_in_words(1.0 / low)} {noun}" if low > 0.0 else f"{noun} or more"
    if not rate.value:
        return f"On the road: less than once in {format_amount_in_words(1.0 / high)} {noun}"
    often = f"once in {format_amount_in_words(1.0 / rate.value)} {noun}"
    return f"On the road: {often} ({format_amount_in_words(1.0 / high)} {rarest})"


def _render_exposure(run: Run) -> Markup | None:
    exposure = None if run.definition is None else run.definition.exposure
    if exposure is None:
        return None
    known = from_exposure(exposure, next(iter(run.values())).confidence)
    source = f"counted {exposure.count:,} times" if exposure.count is not None else "as the scenario says"
    often = f"{known.value:.3g} times per {exposure.unit}"
    often += f" ({known.low:.2g} – {known.high:.2g})" if known.low < known.high else ""
    text = f"This scene is met {often}, {source}."
    return tag("p", text, class_="muted")
