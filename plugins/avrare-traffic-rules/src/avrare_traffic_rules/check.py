"""Mistakes in a rule that can be told without a road: before anything is built, and when it is."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from fractions import Fraction

from avrare.errors import FormulaError, UsageError, did_you_mean
from avrare.logic import formula as f
from avrare.logic.api import Formula, stl
from avrare.plugin.finding import Finding
from avrare_traffic_rules.config import Parameters, TrafficRuleConfig
from avrare_traffic_rules.definitions import DEFINITIONS
from avrare_traffic_rules.rulebook import Rulebook, unfit
from avrare_traffic_rules.vocabulary import Definitions
from avrare_traffic_rules.written import Written, template, written

_ANY_STEP = Fraction(1, 10**9)
"""A step [s] of which every time bound that a person writes is a multiple."""


def check(config: TrafficRuleConfig, dt: float | None) -> list[Finding]:
    """What is wrong or odd in the rule of a configuration; empty if nothing is.

    Args:
        config: The options.
        dt: Step of the simulator [s]; None: not known, and no time bound is refused.
    """
    return read(config, dt)[1]


def read(config: TrafficRuleConfig, dt: float | None) -> tuple[Formula | None, list[Finding]]:
    """The formula of a configuration, None if it has errors, and all that ``check`` finds.

    The formula's ``warnings`` count lines from where the user began to write.
    """
    findings = list(_broken_file(config)) or list(_unfit_options(config))
    if findings:
        return None, findings
    whole = written(config)
    try:
        formula = stl(whole.text, dt=_ANY_STEP if dt is None else dt, warn=False)
    except FormulaError as error:
        return None, [Finding(*whole.located(error.message, error.hint))]
    formula, warnings = _with_own_places(formula, whole)
    unknown = [
        Finding(whole.source + error.message, error.hint, whole.option)
        for error in _unknown_words(formula.node, DEFINITIONS[config.definitions])
    ]
    return None if unknown else formula, unknown + warnings


def require(findings: Sequence[Finding]) -> None:
    """Raise the errors among the findings as one.

    Raises:
        FormulaError: There are some.
    """
    errors = [finding for finding in findings if finding.is_error]
    if errors:
        *before, last = errors
        lines = [part for one in before for part in FormulaError(one.message, one.hint).lines()]
        raise FormulaError("\n".join([*lines, last.message]), last.hint)


def _broken_file(config: TrafficRuleConfig) -> Iterator[Finding]:
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
            message = f"{config.rules_file}: rules.{config.rule}.parameters: {name!r} is no option of a rule"
            yield Finding(message, did_you_mean(name, Parameters.model_fields), "rules_file")


def _unfit_options(config: TrafficRuleConfig) -> Iterator[Finding]:
    option = "formula" if config.formula is not None else "rules_file"
    for error in unfit(template(config), config.model_dump()):
        yield Finding(error.message, error.hint, option)


def _with_own_places(formula: Formula, whole: Written) -> tuple[Formula, list[Finding]]:
    """The formula with its warnings in terms of what the user wrote, and these as findings."""
    told = [whole.located(one.message, one.hint) for one in formula.warnings]
    complaints = tuple(
        dataclasses.replace(one, message=message, hint=hint)
        for one, (message, hint, _) in zip(formula.warnings, told, strict=True)
    )
    findings = [Finding(message, hint, option, is_error=False) for message, hint, option in told]
    return dataclasses.replace(formula, warnings=complaints), findings


def _unknown_words(node: f.Node, definitions: Definitions) -> Iterator[FormulaError]:
    """Groups that are not ``others``, plain signals, unknown predicates and wrong numbers of arguments."""
    told = set()
    for part in f.walk(node):
        try:
            _refuse_unknown(part, definitions)
        except FormulaError as error:
            if error.message not in told:
                told.add(error.message)
                yield error


def _refuse_unknown(part: f.Node | f.Term, definitions: Definitions) -> None:
    if isinstance(part, f.Quantifier) and part.group != "others":
        raise FormulaError(f"there is no group of vehicles {part.group!r}", "quantify over 'others'")
    if isinstance(part, f.Signal) and not part.arguments:
        hint = did_you_mean(part.name, definitions.predicates)
        raise FormulaError(f"{part.name!r} is asked about no vehicle", hint or "write speed(ego), not speed")
    if isinstance(part, f.Signal):
        definitions.find(part.name.split("(")[0], len(part.arguments))
