"""``avrare rules``: the traffic rules that plugins offer, in English and as formulas."""

from __future__ import annotations

import argparse
import dataclasses
import json
import textwrap
from collections.abc import Sequence

from rich import box
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from avrare.cli.output import say
from avrare.cli.plugins import print_wide
from avrare.output.terminal.console import make_console
from avrare.plugin.registry import default_registry
from avrare.plugin.rule_catalogue import Catalogue, Offer

_NARROWEST, _WIDTH = 40, 100


def execute(args: argparse.Namespace) -> None:
    """Print a table of all rules, or the named rules in full."""
    catalogue = Catalogue.of(default_registry())
    for line in catalogue.failures:
        say(f"warning: {line}", error=True)
    matches = [offer for name in args.names for offer in catalogue.find(name, loosely=True)]
    offers = list({id(offer): offer for offer in matches}.values())
    if args.json:
        print(json.dumps([_plain(offer) for offer in offers or catalogue.offers], indent=2))
    elif offers:
        _print_cards(offers)
    else:
        _print_table(catalogue.offers)


def _plain(offer: Offer) -> dict[str, object]:
    return {**dataclasses.asdict(offer.card), "plugin": offer.row.name, "distribution": offer.row.origin}


def _print_table(offers: Sequence[Offer]) -> None:
    if not offers:
        say("no installed plugin offers rules; try: pip install avrare-traffic-rules")
        return
    table = Table("rule", "title", "plugin", box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for offer in offers:
        table.add_row(*map(escape, (offer.card.name, offer.card.title, offer.row.name)))
    print_wide(table)
    say("\n'avrare rules NAME' shows a rule in full.")


def _print_cards(offers: Sequence[Offer]) -> None:
    console = make_console()
    width = max(_NARROWEST, min(console.width, _WIDTH))  # COLUMNS may say anything
    for index, offer in enumerate(offers):
        for line in [*([""] if index else []), *_card(offer, width)]:
            console.print(line)


def _card(offer: Offer, width: int) -> list[Text]:
    def wrap(words: str, indent: int, hanging: int = 0, style: str = "") -> Text:
        first, others = " " * indent, " " * (indent + hanging)
        filled = textwrap.fill(
            words, width, initial_indent=first, subsequent_indent=others, break_on_hyphens=False
        )
        return Text(filled, style)

    card = offer.card
    lines = [Text.assemble((card.name, "bold"), "  ", card.title), Text()]
    lines += [wrap(" ".join(card.text.split()), 2), Text()]
    lines += [wrap(line, 4, 4, "cyan") for line in card.formula.strip().splitlines()]
    if card.remarks:
        lines += [Text(), wrap(" ".join(card.remarks.split()), 2)]
    if card.parameters:
        lines.append(Text())
    settings = [f"{parameter.default} {parameter.unit}".strip() for parameter in card.parameters]
    names = max((len(parameter.name) for parameter in card.parameters), default=0)
    values = max(map(len, settings), default=0)
    for parameter, value in zip(card.parameters, settings, strict=True):
        name, about = (
            parameter.name,
            f"{parameter.text}; {parameter.source}" if parameter.source else parameter.text,
        )
        row = wrap(f"{name:<{names}}  {value:<{values}}  {about}", 2, names + values + 4)
        row.stylize("bold", 2, 2 + len(name))
        lines.append(row)
    lines += [Text(), Text(f"  plugin: {offer.row.name}, {offer.row.origin}")]
    return [*lines, wrap(f"source: {card.source}", 2, 8)]
