"""The verdict and the table of estimates, each interval as a bar on a common logarithmic axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from avrare.report.html.folder import RunFolder
from avrare.report.html.markup import Markup, tag
from avrare.report.html.scales import Scale, decades, power
from avrare.scenario.schema import Threshold

_WORDS = {
    "pass": "Passes",
    "fail": "Fails",
    "inconclusive": "Inconclusive",
    None: "No threshold",
}
_SIGNS = {"pass": "✓", "fail": "✕", "inconclusive": "?", None: "–"}
_RARE = 0.1
"""Below this a probability is told as one of so many."""
_SENTENCES = {
    (None, False): "The scenario sets no threshold, so nothing is judged here.",
    (None, True): "The scenario sets no threshold, so nothing is judged here.",
    ("pass", False): "Every threshold is kept: all of the interval of {} lies below its bound.",
    ("pass", True): "Every threshold is kept: all of the intervals of {} lie below their bounds.",
    ("fail", False): "All of the interval of {} lies above its bound.",
    ("fail", True): "All of the intervals of {} lie above their bounds.",
    ("inconclusive", False): "The interval of {} contains its bound: more simulations will decide.",
    ("inconclusive", True): "The intervals of {} contain their bounds: more simulations will decide.",
}


def badge(verdict: str | None) -> Markup:
    """A verdict as a word with a sign, so that colour is not all that tells it."""
    sign = tag("span", _SIGNS[verdict], aria_hidden="true")
    return tag("span", sign, f" {_WORDS[verdict]}", class_=f"badge {verdict or 'none'}")


def overall(estimates: Sequence[dict[str, Any]]) -> str | None:
    """The worst of the verdicts."""
    found = {one["verdict"] for one in estimates}
    return next((name for name in ("fail", "inconclusive", "pass") if name in found), None)


def hero(folder: RunFolder) -> Markup:
    """The verdict in a word and a sentence."""
    verdict = overall(folder.estimates)
    judged = [one for one in folder.estimates if one["verdict"]]
    passed = sum(one["verdict"] == "pass" for one in judged)
    many = len(folder.estimates)
    counted = f"{passed} of {len(judged)} thresholds kept, " if judged else ""
    seen = sum(one["failures"] > 0 for one in folder.estimates)
    text = (
        f"{counted}{many} {'rule' if many == 1 else 'rules'} estimated, {seen} seen to fail.{_most(folder)}"
    )
    return tag(
        "section", tag("div", badge(verdict), class_="verdict"),
        tag("p", _explained(folder.estimates, verdict), class_="lead"), tag("p", text, class_="muted"),
        class_="hero", aria_label="Verdict",
    )  # fmt: skip


def _explained(estimates: Sequence[dict[str, Any]], verdict: str | None) -> str:
    """What the verdict says, and of which rules."""
    names = [one["specification"] for one in estimates if one["verdict"] == verdict]
    return _SENTENCES[verdict, len(names) > 1].format(_listed(names))


def _listed(names: Sequence[str]) -> str:
    """``a, b and c``."""
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _most(folder: RunFolder) -> str:
    """The rule that is broken most often, in words."""
    most = max(folder.estimates, key=lambda one: one["probability"], default={"probability": 0.0})
    if most["probability"] <= 0.0:
        return ""
    often = " most often," if len(folder.estimates) > 1 else ""
    p = most["probability"]
    share = f"{percent(float(f'{p:.2g}'))} of the simulations"
    if p < _RARE:
        share = f"about one of {_few(1.0 / p)} simulations"
    return f" {most['specification']} is broken{often} in {share}."


def _few(value: float) -> str:
    """Two significant digits: 65, 1,900, 3.4 million."""
    rounded = float(f"{value:.1e}")
    if rounded >= 1e9:
        return scientific(value)
    if rounded >= 1e6:
        return f"{rounded / 1e6:.3g} million"
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.2g}"


def scientific(value: float) -> str:
    """``3.4 × 10¹²``."""
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa} × {power(int(exponent))}"


def table(folder: RunFolder) -> Markup:
    """One row a specification."""
    scale = _axis(folder)
    heads = ("Rule", "Probability", "", "Simulations", "Failures", "Errors", "Verdict")
    kinds = ("", "number", "bars", "number", "number", "number", "")
    row = [
        tag("th", _ticks(scale) if kind == "bars" else head, scope="col", class_=kind or None)
        for head, kind in zip(heads, kinds, strict=True)
    ]
    body = [_row(folder, index, entry, scale) for index, entry in enumerate(folder.estimates)]
    confidence = folder.estimates[0]["confidence"] if folder.estimates else 0.95
    note = (
        f"Probability that a drive breaks the rule. Bars: {percent(confidence)} intervals on a logarithmic "
        "axis; ticks: thresholds."
    )
    return tag(
        "section", tag("h2", "Estimates"), tag("p", note, class_="muted"),
        tag("div", tag("table", tag("thead", tag("tr", row)), tag("tbody", body), class_="estimates")),
        id="estimates",
    )  # fmt: skip


def _row(folder: RunFolder, index: int, entry: dict[str, Any], scale: Scale) -> Markup:
    low, high = entry["interval"]
    name = tag("a", breakable(entry["specification"]), href=f"#rule-{index}")
    value = [
        tag("strong", number(entry["probability"])),
        tag("span", f"{number(low, 2)} – {number(high, 2)}", class_="interval"),
    ]
    thresholds = folder.thresholds(entry["specification"])
    cells = (
        ("Probability", "number", value),
        (None, "bars", bar(entry, scale, [one.limit for one in thresholds])),
        ("Simulations", "number", f"{entry['rollouts']:,}"),
        ("Failures", "number", f"{entry['failures']:,}"),
        ("Errors", "number", f"{entry['errors']:,}"),
        ("Verdict", "", [badge(entry["verdict"]), *(_bound(one) for one in thresholds)]),
    )
    return tag(
        "tr", tag("th", name, scope="row"),
        [tag("td", content, class_=kind or None, data_label=label) for label, kind, content in cells],
    )  # fmt: skip


def bar(entry: dict[str, Any], scale: Scale, limits: Sequence[float]) -> Markup:
    """An interval, its estimate and the thresholds."""
    low, high = entry["interval"]
    probability = entry["probability"]
    begin, end = (scale.at(low) if low > 0.0 else 0.0), scale.at(high)
    words = f"interval from {number(low, 2)} to {number(high, 2)}, estimate {number(probability)}"
    marks = [tag("i", class_="limit", style=f"left:{scale.at(limit)}%") for limit in limits]
    dot = tag("i", class_="point", style=f"left:{scale.at(probability)}%") if probability > 0.0 else None
    style = f"left:{begin}%;width:{max(end - begin, 0.6):.2f}%"
    grid = [tag("i", class_="tick", style=f"left:{scale.at(v)}%") for v, _ in scale.ticks()]
    return tag(
        "div", grid, tag("i", class_="span open" if low <= 0.0 else "span", style=style), marks, dot,
        class_="bar-cell", role="img", aria_label=words,
    )  # fmt: skip


def _axis(folder: RunFolder) -> Scale:
    """Of all intervals, points and thresholds; an interval from 0 gets a decade of its own."""
    values: list[float] = []
    for entry in folder.estimates:
        low, high = entry["interval"]
        values += [low, high, entry["probability"]]
        values += [one.limit for one in folder.thresholds(entry["specification"])]
        values += [high / 10.0] if low <= 0.0 else []
    return decades(values, most=1.0)


def _ticks(scale: Scale) -> Markup:
    marks = [tag("span", word, style=f"left:{scale.at(value)}%") for value, word in scale.ticks()]
    return tag("div", marks, class_="bar-ticks")


def _bound(threshold: Threshold) -> Markup:
    sign = "<" if threshold.strict else "≤"
    return tag("span", f"{sign} {number(threshold.limit)}", class_="bound")


def number(value: float | None, digits: int = 3) -> str:
    """A probability in a few digits: 0, 0.0123, 3.4 × 10⁻⁵."""
    if value is None:
        return "–"
    if value in (0.0, 1.0):
        return f"{value:.0f}"
    return f"{value:.{digits}g}" if value >= 1e-3 else scientific(value)


def breakable(name: str) -> list[Markup | str]:
    """A name that may be broken after its underscores."""
    first, *rest = name.split("_")
    return [first, *(part for word in rest for part in ("_", tag("wbr"), word))]


def percent(share: float) -> str:
    """``95 %``."""
    return f"{100.0 * share:.4g} %"
