"""HTML report of a catalogue's rates: one self-contained file without a script."""

from __future__ import annotations

from importlib.resources import files

from avrare.analysis.rates.combination import Total
from avrare.analysis.rates.rates import CatalogueRates, RuleRate
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.chart import Scale, make_log_scale
from avrare.base.number_format import format_percent, format_typeset, format_typeset_interval
from avrare.report.html.markup import Markup, tag
from avrare.report.terminal.rate_table import describe_blind, describe_scenes, describe_warnings

_SIGNS = {"pass": "✓ Passes", "fail": "✕ Fails", "inconclusive": "? Inconclusive"}


def render_rates(rates: CatalogueRates) -> str:
    """Return the report of a catalogue as HTML."""
    document = rates.catalogue.document
    facts = (
        f"{len(document.scenes)} scenes · {sum(rates.rollouts):,} rollouts · seed {document.seed} · "
        f"{format_percent(document.confidence)} intervals"
    )
    header = tag(
        "header",
        tag("h1", document.name),
        tag("p", document.description, class_="description") if document.description else None,
        tag("p", facts, class_="muted"),
    )
    errors = f"More rollouts ended in an error than allowed: {', '.join(rates.errors)}."
    main = tag(
        "main",
        tag("section", tag("p", errors), class_="note", role="note") if rates.errors else None,
        _render_notes(describe_warnings(rates)),
        _render_rules(rates),
        [_render_scenes(rates, rate) for rate in rates.rates],
        _render_own(rates),
        _render_exposures(rates),
    )
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", f"{document.name} · avrare"),
        tag("style", Markup(files("avrare.report.html").joinpath("style.css").read_text(encoding="utf-8"))),
    )
    body = tag("body", header, main, tag("footer", "Made by avrare"))
    return "<!doctype html>\n" + tag("html", head, body, lang="en") + "\n"


def _render_rules(rates: CatalogueRates) -> Markup:
    rows = [(rate, unit, total) for rate in rates.rates for unit, total in rate.totals.items()]
    scales = {unit: _scale([total for _, other, total in rows if other == unit]) for _, unit, _ in rows}
    body = [_render_rate(rate, unit, total, scales[unit]) for rate, unit, total in rows]
    heads = ("Rule", "Rate", "", "Sampling alone", "Exposure alone", "Verdict")
    note = (
        "How often the rule is violated. Bars, on a logarithmic axis for each unit: the interval of both "
        "uncertainties. Sampling alone: if the exposures were known; exposure alone: if the probabilities "
        "were."
    )
    return tag(
        "section",
        tag("h2", "Rates"),
        tag("p", note, class_="muted"),
        tag("div", _table(heads, body)),
        id="rates",
    )


def _render_rate(rate: RuleRate, unit: str, total: Total, scale: Scale) -> Markup:
    value = [
        tag("strong", f"{format_typeset(total.value)} per {unit}"),
        tag("span", format_typeset_interval(total.interval), class_="interval"),
    ]
    verdicts = [
        [
            tag("span", _SIGNS[one.verdict], class_=f"badge {one.verdict}"),
            tag("span", f"{one.threshold.text}{one.explanation}", class_="bound"),
        ]
        for one in rate.decisions
        if one.threshold.unit == unit
    ]
    cells = [
        value,
        _bar(total, scale),
        *map(format_typeset_interval, (total.sampling, total.exposure)),
        verdicts,
    ]
    kinds = ("number", "bars", "number", "number", None)
    return tag(
        "tr",
        tag("th", rate.rule, scope="row", style="white-space:nowrap;overflow-wrap:normal;word-break:normal"),
        [tag("td", cell, class_=kind) for cell, kind in zip(cells, kinds, strict=True)],
    )


def _scale(totals: list[Total]) -> Scale:
    ends = [end for total in totals for end in (*total.interval, total.value)]
    return make_log_scale([*ends, *(total.interval[1] / 10.0 for total in totals)])


def _bar(total: Total, scale: Scale) -> Markup:
    low, high = total.interval
    begin, end = (scale.at(low) if low > 0.0 else 0.0), scale.at(high)
    dot = tag("i", class_="point", style=f"left:{scale.at(total.value)}%") if total.value > 0.0 else None
    span = tag(
        "i",
        class_="span open" if low <= 0.0 else "span",
        style=f"left:{begin}%;width:{max(end - begin, 0.6):.2f}%",
    )
    words = f"interval from {format_typeset(low, 2)} to {format_typeset(high, 2)}"
    return tag("div", span, dot, class_="bar-cell", role="img", aria_label=words)


def _render_scenes(rates: CatalogueRates, rate: RuleRate) -> Markup:
    total = next(iter(rate.totals.values()))
    entries = sorted(
        zip(rates.catalogue.document.scenes, rates.estimates, total.shares, total.doubts, strict=True),
        key=lambda one: -one[2],
    )
    body = [
        tag(
            "tr",
            tag("th", entry.name, scope="row"),
            tag("td", _found(estimates[rate.rule]), class_="number"),
            tag("td", format_percent(round(share, 3)), class_="number"),
            tag("td", format_percent(round(doubt, 3)), class_="number"),
        )
        for entry, estimates, share, doubt in entries
    ]
    heads = ("Scene", "Failures", "Share of the rate", "Share of the interval's squared width")
    said = describe_scenes(rates, rate)
    return tag(
        "section",
        tag("h2", rate.rule),
        tag("p", f"{said[0].upper()}{said[1:]}.", class_="muted"),
        tag("div", _table(heads, body)),
    )


def _found(estimate: SceneEstimate) -> str:
    if estimate.own is None:
        return f"{estimate.failures:,} of {estimate.rollouts:,}"
    return f"{format_typeset(estimate.own.probability)} by {estimate.own.estimator}"


def _render_notes(lines: list[str]) -> Markup | None:
    if not lines:
        return None
    return tag("section", [tag("p", line) for line in lines], class_="note", role="note")


def _render_own(rates: CatalogueRates) -> Markup | None:
    body = [
        tag(
            "tr",
            tag("th", name, scope="row"),
            tag("td", rule),
            tag("td", own.estimator),
            tag("td", format_typeset(own.probability), class_="number"),
            tag("td", format_typeset_interval(own.interval), class_="number"),
            tag("td", f"{one.rollouts:,}", class_="number"),
            tag("td", f"{own.simulated_steps:,}", class_="number"),
            tag("td", ", ".join(one.warnings) or "–"),
        )
        for name, rule, one, own in rates.own
    ]
    if not body:
        return None
    heads = ("Scene", "Rule", "Estimator", "Probability", "Interval", "Rollouts", "Steps", "Warnings")
    note = "Estimates with intervals of their own. Their cost is no part of what the pilot shares."
    return tag(
        "section",
        tag("h2", "Estimators of the scenes’ own"),
        tag("p", note, class_="muted"),
        tag("div", _table(heads, body)),
        [tag("p", f"{line}.", class_="muted") for line in describe_blind(rates)],
    )


def _render_exposures(rates: CatalogueRates) -> Markup:
    document = rates.catalogue.document
    body = [
        tag(
            "tr",
            tag("th", entry.name, scope="row"),
            tag("td", entry.scenario),
            tag("td", f"{format_typeset(exposure.value)} per {entry.exposure.unit}", class_="number"),
            tag("td", format_typeset_interval((exposure.low, exposure.high)), class_="number"),
            tag("td", f"{rollouts:,}", class_="number"),
        )
        for entry, exposure, rollouts in zip(document.scenes, rates.exposures, rates.rollouts, strict=True)
    ]
    speed = f" Hours and km are converted at {document.speed:g} km/h." if document.speed else ""
    own = " or its own estimator took" if next(rates.own, None) is not None else ""
    note = f"How often each scene is met, and the rollouts that the pilot gave it{own}.{speed}"
    heads = ("Scene", "Scenario", "Exposure", "Interval", "Rollouts")
    return tag(
        "section", tag("h2", "Scenes"), tag("p", note, class_="muted"), tag("div", _table(heads, body))
    )


def _table(heads: tuple[str, ...], body: list[Markup]) -> Markup:
    row = tag("tr", [tag("th", head, scope="col") for head in heads])
    return tag("table", tag("thead", row), tag("tbody", body), class_="estimates")
