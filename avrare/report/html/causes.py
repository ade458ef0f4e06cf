"""Causes of failure in a report: kinds with their probabilities, and what perfect parts would save."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence

from avrare.base.errors import UsageError
from avrare.base.number_format import describe_share, format_typeset, format_typeset_interval
from avrare.report.html.markup import Markup, tag
from avrare.results.reader import RunFolder, StoredEstimate
from avrare.results.stored_causes import (
    StoredAttribution,
    StoredKinds,
    StoredSaving,
    read_attribution,
    read_kinds,
)


def render_causes(folder: RunFolder, entry: StoredEstimate) -> Markup | None:
    """Return what is known of the causes of failure; None without failures.

    Analyses of another result, left in the folder by an earlier run, are not shown.
    """
    if not entry.failures:
        return None
    name = entry.specification
    try:
        kinds, attribution = read_kinds(folder.path).get(name), read_attribution(folder.path).get(name)
    except UsageError as error:
        return tag("p", f"{error.message}.", class_="note", role="note")
    parts = []
    if kinds is not None and kinds.probability == entry.probability:
        parts.append(_render_kinds(kinds))
    else:
        parts.append(_render_command(folder, name, "kinds", "Kinds of failure"))
    if attribution is not None and attribution.probability == entry.probability:
        parts.append(_render_savings(attribution))
    else:
        parts.append(_render_command(folder, name, "attribution", "What to fix first"))
    return tag("div", parts, class_="causes")


def _render_command(folder: RunFolder, name: str, command: str, title: str) -> Markup:
    words = ["avrare", command, str(folder.path), "--specification", name, "--out", str(folder.path)]
    text = "Not analysed. To add it to this report, run this and write the report again:"
    return tag(
        "details", tag("summary", title), tag("p", text, class_="muted"),
        tag("pre", shlex.join(words), class_="command", tabindex=0),
    )  # fmt: skip


def _render_kinds(kinds: StoredKinds) -> Markup:
    rows = [
        (
            str(one.kind), [tag("strong", format_typeset(one.probability)), " ",
                            tag("span", format_typeset_interval((one.low, one.high)), class_="interval")],
            describe_share(one.share),
            [one.text, [tag("span", f" {text}.", class_="muted") for text in one.warnings]],
            str(one.representative),
        )
        for one in kinds.kinds
    ]  # fmt: skip
    count = len(rows)
    title = f"{count} kind{'s' if count > 1 else ''} of failure"
    heads = ("", "Probability", "Share", "What happens", "See failure")
    return tag("div", tag("h3", title), _render_table(heads, rows))


def _render_savings(attribution: StoredAttribution) -> Markup:
    rows = [
        (
            one.perfect, "unknown" if one.low is None else tag("strong", f"{100 * one.saves:.0f} %"),
            "unknown" if one.low is None else f"{100 * one.low:.0f} – {100 * one.high:.0f} %",
            f"{100 * one.vanish:.0f} %", _describe_new(one),
        )
        for one in attribution.perfect
    ]  # fmt: skip
    note = "Share of the probability that each change would save, measured on the same noise tapes."
    heads = ("Change", "Saves", "Interval", "Failures that vanish", "New failures")
    return tag(
        "div", tag("h3", "What to fix first"), tag("p", note, class_="muted"), _render_table(heads, rows)
    )


def _describe_new(one: StoredSaving) -> str:
    if one.new_high >= 1.0:  # without fresh tapes
        return "unknown"
    return f"{format_typeset(one.new, 2)} (up to {format_typeset(one.new_high, 2)})"


def _render_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> Markup:
    head = tag("tr", [tag("th", text, scope="col") for text in heads])
    body = [
        tag("tr", [tag("td", cell, data_label=text or None) for text, cell in zip(heads, row, strict=True)])
        for row in rows
    ]
    return tag("div", tag("table", tag("thead", head), tag("tbody", body)), class_="scroll")
