"""Rules as text: those that come with this package, and those of a file of the user's own."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from avrare.errors import UsageError, did_you_mean
from avrare_traffic_rules import rulesfile
from avrare_traffic_rules.rulesfile import Rule

_OPTION = re.compile(r"\{(\w+)\}")


@dataclass(frozen=True)
class Rulebook:
    """Rules by name, and the definitions that they share.

    Attributes:
        rules: name -> rule.
        definitions: name -> ``name(a, b) = formula``, in one line.
    """

    rules: Mapping[str, Rule]
    definitions: Mapping[str, str]

    def needed(self, formula: str) -> dict[str, str]:
        """The definitions that a formula uses, those that others of them use first."""
        needed: dict[str, str] = {}

        def add(text: str) -> None:
            for name in re.findall(r"(\w+)\s*\(", text):
                if name in self.definitions and name not in needed:
                    definition = self.definitions[name]
                    add(definition.partition("=")[2])
                    needed[name] = definition

        add(formula)
        return needed

    def complete(self, formula: str) -> str:
        """The formula below the definitions that it needs, one a line."""
        return "\n".join([*self.needed(formula).values(), formula])


@functools.cache
def shipped() -> Rulebook:
    """The rules that come with this package."""
    text = (files("avrare_traffic_rules") / "rules.yaml").read_text(encoding="utf-8")
    return _parse(text, "rules.yaml", {})


def read(path: Path) -> Rulebook:
    """The rules of a file, which may also use the definitions that come with this package.

    Raises:
        UsageError: The file cannot be read or is no rules file.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:  # ValueError: bytes that are no text, or a NUL in the path
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise UsageError(f"{path}: {reason}", "give `rules_file` relative to the current folder") from error
    return _parse(text, str(path), shipped().definitions)


def fill(text: str, options: Mapping[str, Any]) -> str:
    """The text with its ``{names}`` replaced by options.

    Raises:
        UsageError: There is no such option, or it is no number.
    """
    error = next(unfit(text, options), None)
    if error is not None:
        raise error
    return _OPTION.sub(lambda match: plain(options[match.group(1)]), text)


def unfit(text: str, options: Mapping[str, Any]) -> Iterator[UsageError]:
    """What is wrong with the ``{names}`` of a text: no options, or none with a number."""
    numbers = {name for name, value in options.items() if isinstance(value, int | float)}
    for name in dict.fromkeys(_OPTION.findall(text)):
        if name not in options:
            yield UsageError(f"{{{name}}} is no option of a traffic rule", did_you_mean(name, numbers))
        elif name not in numbers:
            yield UsageError(f"the option {name} is no number, so a formula cannot have {{{name}}}")


def places(text: str, options: Mapping[str, Any]) -> dict[tuple[int, int], str]:
    """(line, column) where the value of an option begins in the filled text, from 1 -> its name."""
    found = {}
    for match in _OPTION.finditer(text):
        before = fill(text[: match.start()], options)
        found[before.count("\n") + 1, len(before) - before.rfind("\n")] = match.group(1)
    return found


def plain(value: Any) -> str:
    """A number or choice as a person writes it: 3, not 3.0."""
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def _parse(text: str, name: str, definitions: Mapping[str, str]) -> Rulebook:
    content = rulesfile.parse(text, name)
    return Rulebook(content.rules, {**definitions, **_statements(content.definitions, name)})


def _statements(text: str, name: str) -> dict[str, str]:
    """Name -> definition; one that does not fit in a line goes on in indented ones."""
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
