"""A configuration as a formula: definitions, options filled in, and where in it all that stands."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from avrare_traffic_rules.config import TrafficRuleConfig
from avrare_traffic_rules.rulebook import fill, places

_PLACE = re.compile(r"line (\d+), column (\d+): ")


@dataclass(frozen=True)
class Written:
    """A formula with everything that it needs.

    Attributes:
        template: Definitions, one a line, above the formula; options stand in braces.
        text: The same with the options filled in.
        definitions: Names of the definitions, in order.
        options: (line, column) where the value of an option begins in ``text`` -> its name.
        source: What a complaint begins with: empty for a ``formula``, the file or the rule for the rest.
        option: Of the configuration, which says all that: ``formula``, ``rules_file`` or ``rule``.
    """

    template: str
    text: str
    definitions: tuple[str, ...]
    options: Mapping[tuple[int, int], str]
    source: str
    option: str

    def located(self, message: str, hint: str | None) -> tuple[str, str | None, str]:
        """A complaint about ``text`` in terms of what the user wrote: message, hint, option.

        Args:
            message: Of the parser; its place counts from the first definition.
            hint: Of the parser.
        """
        found = _PLACE.match(message)
        if found is None:
            return self.source + message, hint, self.option
        line, column, rest = int(found[1]), int(found[2]), message[found.end() :]
        name = self.options.get((line, column))
        if name is not None:  # the user wrote the option, not the line around it
            first = (hint or "").partition(";")[0]
            return f"{rest.splitlines()[0]} (option {name})", first or None, name
        if line <= len(self.definitions):
            where = f"in the definition of {self.definitions[line - 1]}, column {column}"
        else:
            where = f"line {line - len(self.definitions)}, column {column}"
        return f"{self.source}{where}: {rest}", hint, self.option


def template(config: TrafficRuleConfig) -> str:
    """The formula of a configuration below the definitions that it uses; options stand in braces.

    Raises:
        UsageError: The rules file cannot be read or is none.
    """
    return config.rulebook.complete(_formula(config))


def written(config: TrafficRuleConfig) -> Written:
    """The formula of a configuration.

    Raises:
        UsageError: The rules file is none, or a name in braces stands for no option with a number.
    """
    whole, options = template(config), config.model_dump()
    option = "formula" if config.formula is not None else "rules_file" if config.rules_file else "rule"
    source = {
        "formula": "",
        "rules_file": f"{config.rules_file}: rules.{config.rule}: ",
        "rule": f"{config.rule}: ",
    }[option]
    definitions = tuple(config.rulebook.needed(_formula(config)))
    return Written(whole, fill(whole, options), definitions, places(whole, options), source, option)


def text(config: TrafficRuleConfig) -> str:
    """The formula of a configuration, below the definitions that it uses, with its parameters filled in."""
    return written(config).text


def _formula(config: TrafficRuleConfig) -> str:
    if config.formula is not None:
        return config.formula
    rule = config.rulebook.rules[config.rule or ""]
    return (rule.published if config.definitions == "published" else None) or rule.formula
