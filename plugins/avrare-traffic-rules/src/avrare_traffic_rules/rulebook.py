"""Rules as text: the file that comes with this package, and files of the user's own."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from avrare.errors import UsageError, did_you_mean


class Rule(BaseModel):
    """One entry of a rules file; ``{names}`` in its texts stand for options.

    Attributes:
        title: A few words.
        text: The rule in English.
        formula: Over predicates of vehicles.
        published: The formula of [I24] where it is built differently.
        vehicles: Whom it speaks of unless the scenario says so.
        parameters: The options that it depends on.
        source: Where it comes from.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str = ""
    text: str = ""
    formula: str
    published: str | None = None
    vehicles: Literal["moving", "all"] = "all"
    parameters: tuple[str, ...] = ()
    source: str = ""


class _RulesFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    definitions: str = ""
    rules: dict[str, Rule]


@dataclass(frozen=True)
class Rulebook:
    """Rules by name, and the definitions that they share.

    Attributes:
        rules: name -> rule.
        definitions: name -> ``name(a, b) = formula``, in one line.
    """

    rules: Mapping[str, Rule]
    definitions: Mapping[str, str]

    def complete(self, formula: str) -> str:
        """The formula below the definitions that it needs, one a line."""
        needed: dict[str, str] = {}

        def add(text: str) -> None:
            for name in re.findall(r"(\w+)\s*\(", text):
                if name in self.definitions and name not in needed:
                    definition = self.definitions[name]
                    add(definition.partition("=")[2])
                    needed[name] = definition

        add(formula)
        return "\n".join([*needed.values(), formula])


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
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise UsageError(f"{path}: {reason}") from error
    return _parse(text, str(path), shipped().definitions)


def fill(text: str, options: Mapping[str, Any]) -> str:
    """The text with its ``{names}`` replaced by options.

    Raises:
        UsageError: There is no such option.
    """

    def value(match: re.Match[str]) -> str:
        name = match.group(1)
        if name not in options:
            raise UsageError(f"{{{name}}} is no option of a traffic rule", did_you_mean(name, options))
        return plain(options[name])

    return re.sub(r"\{(\w+)\}", value, text)


def plain(value: Any) -> str:
    """A number or choice as a person writes it: 3, not 3.0."""
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def _parse(text: str, name: str, definitions: Mapping[str, str]) -> Rulebook:
    try:
        content = _RulesFile.model_validate(yaml.safe_load(text))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{name}:{mark.line + 1}:{mark.column + 1}" if mark else name
        raise UsageError(f"{place}: {getattr(error, 'problem', None) or error}") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        path = ".".join(str(step) for step in first["loc"])
        raise UsageError(
            f"{name}: {path}: {first['msg']}", "a rules file has `rules: {NAME: {formula: ...}}`"
        ) from error
    return Rulebook(content.rules, {**definitions, **_statements(content.definitions, name)})


def _statements(text: str, name: str) -> dict[str, str]:
    """Name -> definition; one that does not fit in a line goes on in indented ones."""
    statements = {}
    for statement in re.split(r"\n(?=\S)", text.strip("\n")):
        words = " ".join(statement.split())
        head = re.match(r"(\w+)\s*(\(|=)", words)
        if head is not None:
            statements[head.group(1)] = words
        elif words and not words.startswith("#"):
            raise UsageError(f"{name}: definitions: {words!r}", "write name(a, b) = formula")
    return statements
