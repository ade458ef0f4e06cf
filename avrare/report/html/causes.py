"""Causes of failure in a report: kinds with their probabilities, and what perfect parts would save."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence

from avrare.base.errors import UsageError
from avrare.base.number_format import describe_share, format_typeset, format_typeset_interval
from avrare.estimation.result import Result
from avrare.report.html.kind_pictures import STYLES, draw_map, draw_moment
from avrare.report.html.markup import Markup, tag
from avrare.report.html.rollout_player import name_rollout
from avrare.report.html.stored_rollouts import MonitoredRollout
from avrare.results.run import Run
from avrare.results.stored_causes import (
    StoredAttribution,
    StoredKind,
    StoredKinds,
    StoredSaving,
    read_attribution,
    read_kinds,
)


def find_stored_kinds(run: Run, result: Result) -> StoredKinds | None:
    """Return the stored kinds of an estimate; None without them, or if they are of another result."""
    if run.folder is None:
        return None
    try:
        kinds = read_kinds(run.folder).get(result.specification)
    except UsageError:  # the section says so
        return None
    return kinds if kinds is not None and kinds.probability == result.probability else None


def render_causes(run: Run, result: Result, rollouts: Sequence[MonitoredRollout] = ()) -> Markup | None:
    """Return what is known of the causes of failure; None without failures.

    Analyses of another result, left in the folder by an earlier run, are not shown. ``rollouts`` are those
    that the report shows.
    """
    if not result.failures.count or run.folder is None:
        return None
    name = result.specification
    try:
        read_kinds(run.folder)
        attribution = read_attribution(run.folder).get(name)
    except UsageError as error:
        return tag("p", f"{error.message}.", class_="note", role="note")
    kinds = find_stored_kinds(run, result)
    if kinds is not None:
        parts = [_render_kinds(run, name, kinds, rollouts)]
    else:
        parts = [_render_command(run, name, "kinds", "Kinds of failure")]
    if attribution is not None and attribution.probability == result.probability:
        parts.append(_render_savings(attribution))
        parts.append(_render_command(run, name, "attribution", "The command", ""))
    else:
        parts.append(_render_command(run, name, "attribution", "What to fix first"))
    return tag("div", parts, class_="causes")


def _render_command(
    run: Run, name: str, command: str, title: str,
    text: str = "Not analysed. To add it to this report, run this and write the report again:",
) -> Markup:  # fmt: skip
    words = ["avrare", command, str(run.folder), "--specification", name, "--out", str(run.folder)]
    words += ["--shrink"] if command == "kinds" else []
    return tag(
        "details", tag("summary", title), tag("p", text, class_="muted") if text else None,
        tag("pre", shlex.join(words), class_="command", tabindex=0),
        class_=None if text else "plain",
    )  # fmt: skip


def _render_kinds(run: Run, name: str, kinds: StoredKinds, rollouts: Sequence[MonitoredRollout]) -> Markup:
    shown = {one.stored.index: one for one in rollouts if one.stored.specification == name}
    count = len(kinds.kinds)
    title = f"{count} kind{'s' if count > 1 else ''} of failure"
    cards = [_render_kind(name, one, shown.get(one.representative)) for one in kinds.kinds]
    command = _render_command(run, name, "kinds", "The command", "")
    return tag("div", tag("h3", title), tag("ol", cards, class_="kinds"), draw_map(kinds), command)


def _render_kind(name: str, kind: StoredKind, rollout: MonitoredRollout | None) -> Markup:
    link = f"failure {kind.representative}"
    if rollout is not None:
        link = tag("a", link, href=f"#{name_rollout(name, kind.representative)}")
    head = tag(
        "p", tag("span", f"{kind.kind}", class_=f"number kind-{(kind.kind - 1) % STYLES}"),
        tag("strong", format_typeset(kind.probability)), " ",
        tag("span", format_typeset_interval((kind.low, kind.high)), class_="interval"),
        f" · {describe_share(kind.share)} of the failures",
    )  # fmt: skip
    lines = [
        tag("p", f"{kind.text}. Most typical: ", link, "."),
        tag("p", f"It needs only this: {kind.decisive}.") if kind.decisive else None,
        tag("p", f"{kind.lost[:1].upper()}{kind.lost[1:]}.") if kind.lost else None,
        [tag("p", f"{text[:1].upper()}{text[1:]}.", class_="muted") for text in kind.warnings],
    ]
    picture = draw_moment(rollout) if rollout is not None else None
    return tag("li", tag("div", head, lines), picture)


def _render_savings(attribution: StoredAttribution) -> Markup:
    heads: tuple[str, ...] = ("Change", "Saves", "Interval", "Failures that vanish", "New failures")
    note = "Share of the probability that each change would save, measured on the same noise tapes."
    rows: list[tuple[object, ...]] = [
        (
            one.perfect, "unknown" if one.low is None else tag("strong", f"{100 * one.saves:.0f} %"),
            "unknown" if one.low is None else _format_share(one.low, one.high),
            f"{100 * one.vanish:.0f} %", _describe_new(one),
        )
        for one in attribution.perfect
    ]  # fmt: skip
    if all(one.low is None for one in attribution.perfect):  # without fresh tapes
        heads = ("Change", "Failures that vanish", "Interval")
        note = (
            "Share of the failures that vanish with each change, on the same noise tapes. "
            "Failures that it makes were not looked for (--fresh)."
        )
        rows = [
            (one.perfect, tag("strong", f"{100 * one.vanish:.0f} %"),
             _format_share(one.vanish_low, one.vanish_high))
            for one in attribution.perfect
        ]  # fmt: skip
    return tag(
        "div", tag("h3", "What to fix first"), tag("p", note, class_="muted"), _render_table(heads, rows)
    )


def _format_share(low: float, high: float) -> str:
    return f"{100 * low:.0f} – {100 * high:.0f} %"


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
