"""What a plugin tells of the rules that it offers, for ``avrare rules``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RuleParameter:
    """A number or choice that a rule depends on.

    Attributes:
        name: Its option in a scenario.
        default: As written in a scenario.
        unit: ``m/s``; empty for a pure number or a choice.
        text: What it means.
        source: Where the default comes from.
    """

    name: str
    default: str
    unit: str
    text: str
    source: str


@dataclass(frozen=True)
class RuleCard:
    """A rule as a person reads it.

    Attributes:
        name: As in a scenario: ``R_G1``.
        title: A few words.
        text: The rule in English.
        formula: In the language of ``avrare.stl``, with the default parameters filled in.
        parameters: What can be set.
        source: Where the rule comes from.
    """

    name: str
    title: str
    text: str
    formula: str
    parameters: tuple[RuleParameter, ...]
    source: str
