"""Causes of failure: kinds with their probabilities, and what perfect parts would save."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from avrare.analysis.page.kind_pictures import STYLES, draw_map, draw_moment
from avrare.analysis.page.model import Causes, Command, Kind, Kinds, Savings
from avrare.analysis.page.player import name_rollout
from avrare.analysis.page.stored_rollouts import MonitoredRollout
from avrare.base.number_format import describe_share, format_typeset
from avrare.estimation.result.result import Result
from avrare.results.run import Run
from avrare.results.stored_causes import (
    StoredAttribution,
    StoredCauses,
    StoredKind,
    StoredKinds,
    StoredSaving,
)

_UNKNOWN = "unknown"


def build_causes(
    run: Run, result: Result, stored: StoredCauses, rollouts: Sequence[MonitoredRollout] = ()
) -> Causes | None:
    """Return what is known of the causes of failure; None without failures.

    ``rollouts`` are those that the report shows.
    """
    if not result.failures.count or run.folder is None:
        return None
    if stored.problem:
        return Causes(stored.problem)
    name = result.specification
    kinds, attribution = stored.kinds.get(name), stored.attribution.get(name)
    return Causes(
        "",
        None if kinds is None else _build_kinds(name, kinds, rollouts),
        _write_command(run, name, "kinds", "Kinds of failure", kinds is not None),
        None if attribution is None else _build_savings(attribution),
        _write_command(run, name, "attribution", "What to fix first", attribution is not None),
    )


def _write_command(run: Run, name: str, command: str, title: str, analysed: bool) -> Command:
    words = ["avrare", command, str(run.folder), "--specification", name, "--out", str(run.folder)]
    words += ["--shrink"] if command == "kinds" else []
    text = "Not analysed. To add it to this report, run this and write the report again:"
    return Command("The command" if analysed else title, "" if analysed else text, shlex.join(words))


def _build_kinds(name: str, kinds: StoredKinds, rollouts: Sequence[MonitoredRollout]) -> Kinds:
    shown = {rollout.stored.index: rollout for rollout in rollouts if rollout.stored.specification == name}
    cards = [_build_kind(name, kind, shown.get(kind.representative)) for kind in kinds.kinds]
    return Kinds(tuple(cards), draw_map(kinds))


def _build_kind(name: str, kind: StoredKind, rollout: MonitoredRollout | None) -> Kind:
    sentences = (
        f"It needs only this: {kind.decisive}." if kind.decisive else "",
        f"{_capitalise(kind.lost)}." if kind.lost else "",
    )
    return Kind(
        kind.kind,
        (kind.kind - 1) % STYLES,
        kind.probability,
        (kind.low, kind.high),
        describe_share(kind.share),
        kind.text,
        kind.representative,
        "" if rollout is None else name_rollout(name, kind.representative),
        tuple(filter(None, sentences)),
        tuple(f"{_capitalise(text)}." for text in kind.warnings),
        None if rollout is None else draw_moment(rollout),
    )


def _capitalise(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


def _build_savings(attribution: StoredAttribution) -> Savings:
    if all(saving.low is None for saving in attribution.perfect):  # without fresh tapes
        rows = [
            (
                saving.perfect,
                f"{100 * saving.vanish:.0f} %",
                _format_share(saving.vanish_low, saving.vanish_high),
            )
            for saving in attribution.perfect
        ]
        note = (
            "Share of the failures that vanish with each change, on the same noise tapes. "
            "Failures that it makes were not looked for (--fresh)."
        )
        return Savings(note, ("Change", "Failures that vanish", "Interval"), tuple(rows))
    note = "Share of the probability that each change would save, measured on the same noise tapes."
    heads = ("Change", "Saves", "Interval", "Failures that vanish", "New failures")
    return Savings(note, heads, tuple(map(_list_cells, attribution.perfect)))


def _list_cells(saving: StoredSaving) -> tuple[str, ...]:
    saves = _UNKNOWN if saving.low is None else f"{100 * saving.saves:.0f} %"
    interval = _UNKNOWN if saving.low is None else _format_share(saving.low, saving.high)
    return saving.perfect, saves, interval, f"{100 * saving.vanish:.0f} %", _describe_new(saving)


def _format_share(low: float, high: float) -> str:
    return f"{100 * low:.0f} – {100 * high:.0f} %"


def _describe_new(saving: StoredSaving) -> str:
    if saving.new_high >= 1.0:  # without fresh tapes
        return _UNKNOWN
    return f"{format_typeset(saving.new, 2)} (up to {format_typeset(saving.new_high, 2)})"
