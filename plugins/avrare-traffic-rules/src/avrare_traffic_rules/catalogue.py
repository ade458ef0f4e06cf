"""Catalogue: a card for every rule."""

from __future__ import annotations

from typing import Any

from avrare.plugin import RuleCard, RuleParameter
from avrare_traffic_rules.config import Parameters
from avrare_traffic_rules.rulebook import fill, format_value, read_shipped


def rules() -> list[RuleCard]:
    """Return a card for every rule of this package, with the default parameters."""
    book = read_shipped()
    options = Parameters().model_dump()
    return [
        RuleCard(
            name=name,
            title=rule.title,
            text=fill(rule.text, options),
            formula=fill(book.complete(rule.formula), options),
            parameters=tuple(_parameter(option) for option in rule.parameters),
            source=rule.source,
            remarks=fill(rule.remarks, options),
        )
        for name, rule in book.rules.items()
    ]


def _parameter(option: str) -> RuleParameter:
    field = Parameters.model_fields[option]
    about: Any = field.json_schema_extra
    value = list(field.default) if isinstance(field.default, tuple) else field.default
    text = "null" if value is None else format_value(value)
    return RuleParameter(option, text, about["unit"], field.title or "", about["source"])
