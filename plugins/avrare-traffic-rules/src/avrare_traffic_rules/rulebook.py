"""Rules as text: those of this package, and those of a user's rules file."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from avrare.base.errors import ScenarioError, UsageError, did_you_mean
from avrare.base.stored_files import read_regular
from avrare.scenario.validation import UNKNOWN_KEY, check
from avrare.scenario.yaml import MAX_BYTES
from avrare.scenario.yaml import parse as parse_yaml

_OPTION = re.compile(r"\{(\w+)\}")
_HINT = "a rules file has `rules: {NAME: {formula: ...}}`"


class Rule(BaseModel):
    """Entry of a rules file; ``{names}`` in its texts stand for options.

    Attributes:
        title: A few words.
        text: The rule in English.
        formula: Formula over predicates of vehicles.
        published: The formula of [I24], if it differs in structure.
        vehicles: Vehicles that the rule is about unless the scenario says otherwise.
        parameters: Options that the rule depends on.
        remarks: How details of the rule are read.
        source: Source of the rule.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str = ""
    text: str = ""
    formula: str
    published: str | None = None
    vehicles: Literal["moving", "all"] = "all"
    parameters: tuple[str, ...] = ()
    remarks: str = ""
    source: str = ""


class _RulesFile(BaseModel):
    """Content of a rules file.

    Attributes:
        definitions: ``name(a, b) = formula``, one per line; indented lines continue a definition.
        rules: Name -> rule.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    definitions: str = ""
    rules: dict[str, Rule] = Field(min_length=1)


@dataclass(frozen=True)
class Rulebook:
    """Rules by name, and the definitions that they share.

    Attributes:
        rules: Rules by name.
        definitions: ``name(a, b) = formula`` in one line, by name.
    """

    rules: Mapping[str, Rule]
    definitions: Mapping[str, str]

    def find_definitions(self, formula: str) -> dict[str, str]:
        """Return the definitions that a formula uses, each after those that it uses."""
        needed: dict[str, str] = {}
        seen: set[str] = set()  # a definition may use itself: the parser says so
        pending = [(name, False) for name in self._used(formula)]
        while pending:
            name, complete = pending.pop()
            if complete:
                needed[name] = self.definitions[name]
            elif name not in seen:
                seen.add(name)
                inner = self._used(self.definitions[name].partition("=")[2])
                pending += [(name, True), *((other, False) for other in inner)]
        return needed

    def _used(self, formula: str) -> list[str]:
        """Return the names of definitions in a text, the last one first."""
        return [name for name in reversed(re.findall(r"(\w+)\s*\(", formula)) if name in self.definitions]

    def complete(self, formula: str) -> str:
        """Return the formula below the definitions that it needs, one per line."""
        return "\n".join([*self.find_definitions(formula).values(), formula])


@functools.cache
def read_shipped() -> Rulebook:
    """Return the rules of this package."""
    return _parse((files("avrare_traffic_rules") / "rules.yaml").read_bytes(), "rules.yaml", {})


def read(path: Path) -> Rulebook:
    """Read the rules of a file, which may also use the definitions of this package.

    Raises:
        UsageError: The file cannot be read, is not YAML or not a rules file; ``FILE:LINE:COLUMN:`` if known.
    """
    try:
        data = read_regular(path, MAX_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise UsageError(f"{path}: {reason}", "give `rules_file` relative to the current folder") from error
    return _read_once(data, str(path))


@functools.lru_cache(maxsize=4)  # one command asks several times: to list, to check and to build
def _read_once(data: bytes, name: str) -> Rulebook:
    return _parse(data, name, read_shipped().definitions)


def fill(text: str, options: Mapping[str, object]) -> str:
    """Replace the ``{names}`` of a text by options.

    Raises:
        UsageError: The option does not exist, or is not a number.
    """
    for error in invalid_options(text, options):
        raise error
    return _OPTION.sub(lambda match: format_value(options[match.group(1)]), text)


def invalid_options(text: str, options: Mapping[str, object]) -> Iterator[UsageError]:
    """Yield an error for each of the ``{names}`` of a text that is not an option with a number."""
    numbers = {name for name, value in options.items() if isinstance(value, int | float)}
    for name in dict.fromkeys(_OPTION.findall(text)):
        if name not in options:
            yield UsageError(f"{{{name}}} is not an option of traffic rules", did_you_mean(name, numbers))
        elif name not in numbers:
            yield UsageError(f"the option {name} is not a number, so a formula cannot contain {{{name}}}")


def option_positions(text: str, options: Mapping[str, object]) -> dict[tuple[int, int], str]:
    """Return the names of options by the (line, column), from 1, of their value in the filled text."""
    positions = {}
    for match in _OPTION.finditer(text):
        before = fill(text[: match.start()], options)
        positions[before.count("\n") + 1, len(before) - before.rfind("\n")] = match.group(1)
    return positions


def format_value(value: object) -> str:
    """Format a number or a choice; 3, not 3.0."""
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def _parse(data: bytes, name: str, definitions: Mapping[str, str]) -> Rulebook:
    try:
        root = parse_yaml(data, name, "rules file", _HINT, merge_keys=True)
    except ScenarioError as error:
        message, hint = error.problems[0]
        raise UsageError(message, hint or _HINT) from None
    content, mistakes = check(_RulesFile, root)
    if content is None:
        first = min(mistakes, key=lambda mistake: mistake.text != UNKNOWN_KEY)  # it explains a missing key
        raise UsageError(first.message, first.hint or _HINT)
    return Rulebook(content.rules, {**definitions, **_statements(content.definitions, name)})


def _statements(text: str, name: str) -> dict[str, str]:
    """Split definitions by name; indented lines continue the line above."""
    statements = {}
    for statement in re.split(r"\n(?=\S)", text.strip("\n")):
        words = " ".join(statement.split())
        head = re.match(r"(\w+)\s*(\(|=)", words)
        if head is not None:
            if any(words.count(left) != words.count(right) for left, right in ("()", "[]")):
                raise UsageError(f"{name}: definitions.{head.group(1)}: brackets do not match: {words}")
            statements[head.group(1)] = words
        elif words and not words.startswith("#"):
            raise UsageError(f"{name}: definitions: {words!r}", "write name(a, b) = formula")
    return statements
