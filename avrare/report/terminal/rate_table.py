"""Tables of a catalogue's rates: the rules, and the scenes that contribute most."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from avrare.analysis.rates.rates import CatalogueRates, RuleRate
from avrare.base.number_format import format_interval, format_percent, format_probability
from avrare.report.terminal.console import colour_verdict, make_table, print_lines, print_table

MOST = 3
"""Scenes that are named for each rule."""


def print_rates(console: Console, rates: CatalogueRates, quiet: bool = False) -> None:
    """Print the rates with their intervals; in quiet mode the verdicts alone."""
    document = rates.catalogue.document
    if not quiet:
        table = make_table(
            f"{document.name}  {len(document.scenes)} scenes, {sum(rates.rollouts):,} rollouts, "
            f"{format_percent(document.confidence)} intervals",
            ("rule", "unit"),
            ("rate", "interval", "sampling alone", "exposure alone"),
        )
        for rate in rates.rates:
            for unit, total in rate.totals.items():
                shown = (total.interval, total.sampling, total.exposure)
                cells = [format_probability(total.value), *map(format_interval, shown)]
                table.add_row(escape(rate.rule), f"per {unit}", *cells)
        print_table(console, table)
        print_lines(console, [f"{rate.rule}: {describe_scenes(rates, rate)}" for rate in rates.rates])
    for rate in rates.rates:
        for one in rate.decisions:
            console.print(f"{escape(rate.rule)} {one.threshold.text}: {colour_verdict(one.verdict)}")
    if rates.errors:
        names = ", ".join(rates.errors)
        print_lines(console, [f"more rollouts ended in an error than allowed: {names}"], "red")


def describe_scenes(rates: CatalogueRates, rate: RuleRate) -> str:
    """Return the scenes that contribute most to a rate, and the one that its interval owes most to."""
    total = next(iter(rate.totals.values()))
    names = [entry.name for entry in rates.catalogue.document.scenes]
    doubtful = max(zip(total.doubts, names, strict=True))
    doubt = f"{format_percent(round(doubtful[0], 2))} of the interval's squared width is from {doubtful[1]}"
    if not total.value:
        return f"no failure was seen; {doubt}"
    largest = sorted(zip(total.shares, names, strict=True), reverse=True)[:MOST]
    parts = [f"{name} {format_percent(round(share, 2))}" for share, name in largest if share]
    return f"mostly {', '.join(parts)}; {doubt}"
