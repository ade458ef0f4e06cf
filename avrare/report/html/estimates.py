"""Table of a report with a row for each specification, on a common logarithmic axis."""

from __future__ import annotations

from collections.abc import Sequence

from avrare.base.number_format import format_percent, format_typeset, format_typeset_interval
from avrare.estimation.result import Result
from avrare.report.html.line_chart import Scale, make_log_scale
from avrare.report.html.markup import Markup, link_command, tag
from avrare.report.html.verdict import render_badge
from avrare.results.run import Run


def render_estimates(run: Run) -> Markup:
    """Return the table with a row for each specification."""
    scale = _make_axis(run)
    heads = ("Specification", "Probability", "", "Rollouts", "Failures", "Errors", "Verdict")
    kinds = ("", "number", "bars", "number", "number", "number", "")
    marks = [tag("span", word, style=f"left:{scale.at(value)}%") for value, word in scale.ticks()]
    ticks = tag("div", marks, class_="bar-ticks")
    row = [
        tag("th", ticks if kind == "bars" else head, scope="col", class_=kind or None)
        for head, kind in zip(heads, kinds, strict=True)
    ]
    body = [_render_row(run, index, result, scale) for index, result in enumerate(run.values())]
    confidence = next(iter(run.values())).confidence
    note = (
        f"Probability that a rollout violates the specification. Bars: {format_percent(confidence)} "
        "intervals on a logarithmic axis; ticks: thresholds."
    )
    return tag(
        "section", tag("h2", "Estimates", link_command("run")), tag("p", note, class_="muted"),
        tag("div", tag("table", tag("thead", tag("tr", row)), tag("tbody", body), class_="estimates")),
        id="estimates",
    )  # fmt: skip


def _render_row(run: Run, index: int, result: Result, scale: Scale) -> Markup:
    name = tag("a", allow_breaks(result.specification), href=f"#specification-{index}")
    value = [
        tag("strong", format_typeset(result.probability)),
        tag("span", format_typeset_interval(result.interval), class_="interval"),
    ]
    thresholds = run.thresholds(result.specification)
    bounds = [
        tag("span", f"{'<' if one.strict else '≤'} {format_typeset(one.limit)}", class_="bound")
        for one in thresholds
    ]
    cells = (
        ("Probability", "number", value),
        (None, "bars", _draw_bar(result, scale, [one.limit for one in thresholds])),
        ("Rollouts", "number", f"{result.rollouts:,}"),
        ("Failures", "number", f"{result.failures.count:,}"),
        ("Errors", "number", f"{result.errors:,}"),
        ("Verdict", "", [render_badge(result.verdict), bounds]),
    )
    return tag(
        "tr", tag("th", name, scope="row"),
        [tag("td", content, class_=kind or None, data_label=label) for label, kind, content in cells],
    )  # fmt: skip


def _draw_bar(result: Result, scale: Scale, limits: Sequence[float]) -> Markup:
    low, high = result.interval
    probability = result.probability
    begin, end = (scale.at(low) if low > 0.0 else 0.0), scale.at(high)
    ends = f"from {format_typeset(low, 2)} to {format_typeset(high, 2)}"
    words = f"interval {ends}, estimate {format_typeset(probability)}"
    marks = [tag("i", class_="limit", style=f"left:{scale.at(limit)}%") for limit in limits]
    dot = tag("i", class_="point", style=f"left:{scale.at(probability)}%") if probability > 0.0 else None
    style = f"left:{begin}%;width:{max(end - begin, 0.6):.2f}%"
    grid = [tag("i", class_="tick", style=f"left:{scale.at(v)}%") for v, _ in scale.ticks()]
    return tag(
        "div", grid, tag("i", class_="span open" if low <= 0.0 else "span", style=style), marks, dot,
        class_="bar-cell", role="img", aria_label=words,
    )  # fmt: skip


def _make_axis(run: Run) -> Scale:
    # An interval from 0 gets a decade of its own.
    values: list[float] = []
    for result in list(run.values()):
        low, high = result.interval
        values += [low, high, result.probability]
        values += [one.limit for one in run.thresholds(result.specification)]
        values += [high / 10.0] if low <= 0.0 else []
    return make_log_scale(values, most=1.0)


def allow_breaks(name: str) -> list[Markup | str]:
    """Return a name that may be broken after each underscore."""
    first, *rest = name.split("_")
    return [first, *(part for word in rest for part in ("_", tag("wbr"), word))]
