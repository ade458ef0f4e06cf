"""A rules file as data: what its entries are, and what is wrong with one, at its line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from avrare.errors import UsageError, did_you_mean

_HINT = "a rules file has `rules: {NAME: {formula: ...}}`"
_EXPECTED = {
    "string_type": "a string",
    "dict_type": "a mapping",
    "model_type": "a mapping",
    "tuple_type": "a list",
}


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


class RulesFile(BaseModel):
    """The whole file.

    Attributes:
        definitions: ``name(a, b) = formula``, one a line or gone on with in indented ones.
        rules: name -> rule.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    definitions: str = ""
    rules: dict[str, Rule] = Field(min_length=1)


def parse(text: str, name: str) -> RulesFile:
    """The content of a rules file.

    Args:
        text: The file's.
        name: Of the file, for messages.

    Raises:
        UsageError: It is no YAML, or no rules file; the message begins with ``name:line:column:``.
    """
    root, content = _load(text, name)
    if root is None:
        raise UsageError(f"{name}: the file is empty", _HINT)
    try:
        return RulesFile.model_validate(content)
    except ValidationError as error:
        # an unknown key explains the missing one
        first = min(error.errors(include_url=False), key=lambda one: one["type"] != "extra_forbidden")
        steps = [str(step) for step in first["loc"] if step != "[key]"]
        what, hint = _words(first, steps)
        path = f"{'.'.join(steps)}: " if steps else ""
        raise UsageError(f"{_place(name, _nearest(root, steps))}: {path}{what}", hint) from None


def _load(text: str, name: str) -> tuple[yaml.Node | None, Any]:
    """The file as nodes with places and as plain data."""
    try:
        loader = yaml.SafeLoader(text)
        root = loader.get_single_node()
        if root is not None:
            _refuse_doubles(root, name)
        return root, None if root is None else loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        place = _place(name, error.problem_mark or error.context_mark)
        raise UsageError(f"{place}: not YAML: {error.problem or 'cannot be read'}", _HINT) from None
    except yaml.reader.ReaderError as error:
        before = text[: error.position]
        place = f"{name}:{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"
        reason = f"the character {text[error.position]!r} is not allowed"
        raise UsageError(f"{place}: not YAML: {reason}", _HINT) from None
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else " ".join(str(error).split())
        raise UsageError(f"{name}: not YAML: {reason}", _HINT) from None


def _refuse_doubles(node: yaml.Node, name: str, depth: int = 3) -> None:
    """YAML keeps the last of two equal keys and says nothing; rules are three mappings deep."""
    keys = set()
    for key, value in node.value if depth and isinstance(node, yaml.MappingNode) else ():
        if isinstance(key, yaml.ScalarNode):
            if key.value in keys:
                place = _place(name, key.start_mark)
                raise UsageError(f"{place}: duplicate key {key.value!r}", "keep one of them")
            keys.add(key.value)
        _refuse_doubles(value, name, depth - 1)


def _nearest(node: yaml.Node, steps: Sequence[str]) -> Any:
    """Where the entry is that the steps lead to, or the last one that there is."""
    mark = node.start_mark
    for step in steps:
        pairs = node.value if isinstance(node, yaml.MappingNode) else ()
        found = next(((key, value) for key, value in pairs if key.value == step), None)
        if found is None:
            break
        mark, node = found[0].start_mark, found[1]
    return mark


def _place(name: str, mark: Any) -> str:
    return f"{name}:{mark.line + 1}:{mark.column + 1}" if mark else name


def _words(error: Any, steps: Sequence[str]) -> tuple[str, str | None]:
    """What is wrong with the entry that the steps lead to, and a hint."""
    kind = error["type"]
    if kind == "extra_forbidden":
        known = RulesFile.model_fields if len(steps) == 1 else Rule.model_fields
        return "unknown key", did_you_mean(steps[-1], known)
    if kind == "missing":
        return "required, but missing", _HINT
    if error["loc"][-1:] == ("[key]",):
        return "a name should be a string", "put it in quotes"
    if kind == "too_short":
        return "there is no rule", _HINT
    if kind == "literal_error":
        return f"should be {error['ctx']['expected']}", None
    return f"should be {_EXPECTED.get(kind, 'something else')}", _HINT
