"""Tables of a catalogue's rates: the rules, and the scenes that contribute most."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from avrare.analysis.rates.rates import BROKEN, CatalogueRates
from avrare.analysis.rates.sentences import (
    describe_blind,
    describe_grid,
    describe_scenes,
    describe_warnings,
    list_scenes,
)
from avrare.base.number_format import format_count, format_interval, format_percent, format_probability
from avrare.output.terminal.console import colour_verdict, make_table, print_lines, print_table


def print_rates(console: Console, rates: CatalogueRates, quiet: bool = False) -> None:
    """Print the rates with their intervals; in quiet mode the verdicts alone."""
    document = rates.catalogue.document
    if not quiet:
        table = make_table(
            f"{document.name}  {format_count(len(document.scenes), 'scene')}, "
            f"{format_count(sum(rates.rollouts), 'rollout')}, "
            f"{format_percent(document.confidence)} intervals",
            ("rule", "unit"),
            ("rate", "interval", "sampling alone", "exposure alone"),
        )
        for rate in rates.rates:
            for unit, total in rate.totals.items():
                intervals = (total.interval, total.sampling, total.exposure)
                cells = [format_probability(total.value), *map(format_interval, intervals)]
                table.add_row(escape(rate.rule), f"per {unit}", *cells)
        print_table(console, table)
        print_lines(console, [f"{rate.rule}: {describe_scenes(rates, rate)}" for rate in rates.rates])
        _print_scenes(console, rates)
        _print_own_estimates(console, rates)
        print_lines(console, describe_warnings(rates), "yellow")
        print_lines(console, [*describe_blind(rates), *describe_grid(rates)])
    print_lines(console, [balance.describe(rates.driver) for balance in rates.balances], "bold")
    for rate in rates.rates:
        for decision in rate.decisions:
            verdict = f"{colour_verdict(decision.verdict)}{escape(decision.explanation)}"
            console.print(f"{escape(rate.rule)} {decision.threshold.text}: {verdict}")
    if rates.errors:
        print_lines(console, [f"{BROKEN}: {', '.join(rates.errors)}"], "red")


def _print_own_estimates(console: Console, rates: CatalogueRates) -> None:
    rows = list(rates.own)
    if not rows:
        return
    heads = ("probability", "interval", "rollouts", "steps")
    table = make_table("estimates with intervals of their own", ("scene", "rule", "estimator"), heads)
    for name, rule, estimate in rows:
        result = estimate.result
        numbers = [format_probability(result.probability), format_interval(result.interval)]
        cost = [f"{result.rollouts:,}", f"{result.simulated_steps:,}"]
        table.add_row(escape(name), escape(rule), result.estimator, *numbers, *cost)
    print_table(console, table)


def _print_scenes(console: Console, rates: CatalogueRates) -> None:
    rows = list_scenes(rates)
    if not rows:
        return
    heads = ("stack", "interval", rates.driver, "interval", "stack / driver", "share")
    table = make_table("probabilities of each scene, and its share of the rate", ("rule", "scene"), heads)
    for row in rows:
        table.add_row(*map(escape, row))
    print_table(console, table)
