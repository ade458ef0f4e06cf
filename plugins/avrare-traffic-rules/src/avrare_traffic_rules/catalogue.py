"""The rules as cards that a person reads; imports nothing heavy."""

from __future__ import annotations

from typing import Any

from avrare.plugin.rulecard import RuleCard, RuleParameter
from avrare_traffic_rules.config import Parameters
from avrare_traffic_rules.rulebook import Rulebook, fill, plain, shipped


def rules() -> list[RuleCard]:
    """A card for every rule that comes with this package, with the default parameters filled in."""
    book = shipped()
    return [_card(book, name) for name in book.rules]


def _card(book: Rulebook, name: str) -> RuleCard:
    rule, options = book.rules[name], Parameters().model_dump()
    return RuleCard(
        name=name,
        title=rule.title,
        text=fill(rule.text, options),
        formula=fill(book.complete(rule.formula), options),
        parameters=tuple(_parameter(option) for option in rule.parameters),
        source=rule.source,
    )


def _parameter(option: str) -> RuleParameter:
    field = Parameters.model_fields[option]
    about: Any = field.json_schema_extra
    default = field.default
    written = "null" if default is None else plain(list(default) if isinstance(default, tuple) else default)
    return RuleParameter(option, written, about["unit"], field.title or "", about["source"])
