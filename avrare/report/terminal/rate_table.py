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
        _print_own(console, rates)
        print_lines(console, describe_warnings(rates), "yellow")
        print_lines(console, describe_blind(rates))
    for rate in rates.rates:
        for one in rate.decisions:
            verdict = f"{colour_verdict(one.verdict)}{escape(one.explanation)}"
            console.print(f"{escape(rate.rule)} {one.threshold.text}: {verdict}")
    if rates.errors:
        names = ", ".join(rates.errors)
        print_lines(console, [f"more rollouts ended in an error than allowed: {names}"], "red")


def _print_own(console: Console, rates: CatalogueRates) -> None:
    rows = list(rates.own)
    if not rows:
        return
    heads = ("probability", "interval", "rollouts", "steps")
    table = make_table("estimates with intervals of their own", ("scene", "rule", "estimator"), heads)
    for name, rule, one, own in rows:
        numbers = [format_probability(own.probability), format_interval(own.interval)]
        cost = [f"{one.rollouts:,}", f"{own.simulated_steps:,}"]
        table.add_row(escape(name), escape(rule), own.estimator, *numbers, *cost)
    print_table(console, table)


def describe_warnings(rates: CatalogueRates) -> list[str]:
    """Return the health warnings of all scenes; each line once, with the scenes and rules that it is of."""
    lines: dict[str, list[str]] = {}
    for entry, estimates in zip(rates.catalogue.document.scenes, rates.estimates, strict=True):
        for rule, one in estimates.items():
            for name, text in one.warnings.items():
                lines.setdefault(f"warning {name}: {text}", []).append(f"{entry.name} {rule}")
    return [f"{', '.join(places)}: {text}" for text, places in lines.items()]


def describe_blind(rates: CatalogueRates) -> list[str]:
    """Return what the rates leave out of failures that the scores of estimators do not lead to."""
    found = []
    for rate in rates.rates:
        for unit, bound in list(rate.blind.items())[:1]:
            text = "failures that the score or proposal of a scene's estimator does not lead to"
            found.append(f"{rate.rule}: {text} could add {format_probability(bound, 2)} per {unit}")
    return found


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
