"""Formula of a configuration, checked before anything is built: everything that needs no road."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from avrare.base.errors import FormulaError, UsageError, did_you_mean
from avrare.logic.formula import Formula, stl
from avrare.logic.syntax import nodes
from avrare.plugin import Finding
from avrare_traffic_rules.config import Parameters, TrafficRuleConfig
from avrare_traffic_rules.definitions import DEFINITIONS
from avrare_traffic_rules.rulebook import Rulebook, fill, invalid_options, option_positions
from avrare_traffic_rules.vocabulary import Definitions


@dataclass(frozen=True)
class FormulaText:
    """Text of a formula with its definitions.

    Attributes:
        text: Definitions, one per line, above the formula, with the options filled in.
        definitions: Names of the definitions, in order.
        options: Names of options by the (line, column) where their value begins in ``text``.
        source: Beginning of a message: empty for a ``formula``, else the file or the rule.
        option: Option of the configuration that gives the formula: ``formula``, ``rules_file`` or ``rule``.
    """

    text: str
    definitions: tuple[str, ...]
    options: Mapping[tuple[int, int], str]
    source: str
    option: str

    def relocate(self, message: str, hint: str | None) -> tuple[str, str | None, str]:
        """Express a message about ``text`` in the words of the user: message, hint, option.

        Args:
            message: Message of the parser, with a position counted from the first definition.
            hint: Hint of the parser.
        """
        place = re.match(r"line (\d+), column (\d+): ", message)
        if place is None:
            return self.source + message, hint, self.option
        line, column, rest = int(place[1]), int(place[2]), message[place.end() :]
        name = self.options.get((line, column))
        if name is not None:  # the user wrote the option, not the line around it
            first = (hint or "").partition(";")[0]
            return f"{rest.splitlines()[0]} (option {name})", first or None, name
        if line <= len(self.definitions):
            where = f"in the definition of {self.definitions[line - 1]}, column {column}"
        else:
            where = f"line {line - len(self.definitions)}, column {column}"
        return f"{self.source}{where}: {rest}", hint, self.option


def check(config: TrafficRuleConfig, dt: float | None) -> list[Finding]:
    """Return errors and warnings about the rule of a configuration.

    Args:
        config: The options.
        dt: Step of the simulator [s]; None if unknown, then every time bound is accepted.
    """
    return parse_rule(config, dt)[1]


def parse_rule(config: TrafficRuleConfig, dt: float | None) -> tuple[Formula | None, list[Finding]]:
    """Return the formula of a configuration, None if it has errors, and the findings of ``check``.

    The formula's ``warnings`` count lines from the first line that the user wrote.
    """
    findings = list(_check_file(config)) or list(_check_options(config))
    if findings:
        return None, findings
    text = formula_text(config)
    try:
        any_step = Fraction(1, 10**9)  # step [s] that divides every decimal time bound
        formula = stl(text.text, dt=any_step if dt is None else dt, warn=False)
    except FormulaError as error:
        return None, [Finding(*text.relocate(error.message, error.hint))]
    formula, warnings = _relocate_warnings(formula, text)
    unknown = [
        Finding(text.source + error.message, error.hint, text.option)
        for error in _unknown_names(formula.node, DEFINITIONS[config.definitions])
    ]
    return None if unknown else formula, unknown + warnings


def raise_errors(findings: Sequence[Finding]) -> None:
    """Raise the errors among the findings as one.

    Raises:
        FormulaError: There is at least one.
    """
    errors = [finding for finding in findings if finding.is_error]
    if errors:
        *before, last = errors
        lines = [part for finding in before for part in FormulaError(finding.message, finding.hint).lines()]
        raise FormulaError("\n".join([*lines, last.message]), last.hint)


def _check_file(config: TrafficRuleConfig) -> Iterator[Finding]:
    try:
        book: Rulebook = config.rulebook
    except UsageError as error:
        yield Finding(error.message, error.hint, "rules_file")
        return
    if config.rule is not None and config.rule not in book.rules:
        message = f"{config.rules_file or 'this package'} has no rule {config.rule!r}"
        yield Finding(message, did_you_mean(config.rule, book.rules), "rule")
        return
    for name in book.rules[config.rule].parameters if config.rule is not None else ():
        if name not in Parameters.model_fields:
            message = f"{name!r} is not an option of traffic rules"
            message = f"{config.rules_file}: rules.{config.rule}.parameters: {message}"
            yield Finding(message, did_you_mean(name, Parameters.model_fields), "rules_file")


def _check_options(config: TrafficRuleConfig) -> Iterator[Finding]:
    option = "formula" if config.formula is not None else "rules_file"
    for error in invalid_options(_formula_template(config), config.model_dump()):
        yield Finding(error.message, error.hint, option)


def _relocate_warnings(formula: Formula, text: FormulaText) -> tuple[Formula, list[Finding]]:
    relocated = [text.relocate(warning.message, warning.hint) for warning in formula.warnings]
    warnings = tuple(
        dataclasses.replace(warning, message=message, hint=hint)
        for warning, (message, hint, _) in zip(formula.warnings, relocated, strict=True)
    )
    findings = [Finding(message, hint, option, is_error=False) for message, hint, option in relocated]
    return dataclasses.replace(formula, warnings=warnings), findings


def _unknown_names(node: nodes.Node, definitions: Definitions) -> Iterator[FormulaError]:
    reported = set()
    for part in nodes.walk(node):
        try:
            _require_known(part, definitions)
        except FormulaError as error:
            if error.message not in reported:
                reported.add(error.message)
                yield error


def _require_known(part: nodes.Node | nodes.Term, definitions: Definitions) -> None:
    if isinstance(part, nodes.Quantifier) and part.group != "others":
        raise FormulaError(f"unknown group of vehicles {part.group!r}", "quantify over 'others'")
    if isinstance(part, nodes.Signal) and not part.arguments:
        hint = did_you_mean(part.name, definitions.predicates)
        raise FormulaError(
            f"{part.name!r} has no vehicle as its argument", hint or "write speed(ego), not speed"
        )
    if isinstance(part, nodes.Signal):
        definitions.find(part.name.split("(")[0], len(part.arguments))


def _formula_template(config: TrafficRuleConfig) -> str:
    return config.rulebook.complete(_rule_formula(config))


def formula_text(config: TrafficRuleConfig) -> FormulaText:
    """Return the formula of a configuration with its options filled in.

    Raises:
        UsageError: The rules file is invalid, or a name in braces is not an option with a number.
    """
    template, options = _formula_template(config), config.model_dump()
    option = "formula" if config.formula is not None else "rules_file" if config.rules_file else "rule"
    source = {
        "formula": "",
        "rules_file": f"{config.rules_file}: rules.{config.rule}: ",
        "rule": f"{config.rule}: ",
    }[option]
    definitions = tuple(config.rulebook.find_definitions(_rule_formula(config)))
    return FormulaText(
        fill(template, options), definitions, option_positions(template, options), source, option
    )


def _rule_formula(config: TrafficRuleConfig) -> str:
    if config.formula is not None:
        return config.formula
    rule = config.rulebook.rules[config.rule or ""]
    return (rule.published if config.definitions == "published" else None) or rule.formula
