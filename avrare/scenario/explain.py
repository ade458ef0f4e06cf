"""Mistakes in a scenario: where they are, what is wrong, what to do. All at once, by place."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from avrare.errors import ExitCode, ScenarioError, did_you_mean
from avrare.scenario.fields import field_at, names_at
from avrare.scenario.source import Mark, Node, Path, dotted

Model = TypeVar("Model", bound=BaseModel)

_EXPECTED = {
    "bool_type": "true or false",
    "dict_type": "a mapping",
    "float_type": "a number",
    "frozen_set_type": "a list",
    "int_from_float": "a whole number",
    "int_type": "a whole number",
    "list_type": "a list",
    "model_type": "a mapping",
    "dataclass_type": "a mapping",
    "none_required": "null",
    "set_type": "a list",
    "string_type": "a string",
    "tuple_type": "a list",
}


_COUNTED = r"should have \2, found \3"
"""How many entries there are too few or too many, without the type that only the code knows."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong.

    Attributes:
        mark: Its place.
        path: Keys that lead to it.
        text: What is wrong.
        hint: What to do.
        exit_code: ``ExitCode.PLUGIN`` for a missing plugin.
    """

    mark: Mark
    path: Path
    text: str
    hint: str | None = None
    exit_code: ExitCode = ExitCode.USAGE

    @property
    def message(self) -> str:
        """``file:line:column: path: what is wrong``; ``--set KEY: ...`` does not repeat its KEY."""
        path = dotted(self.path)
        where = [str(self.mark)] + (
            [path] if path and self.mark.file != f"--set {'.'.join(map(str, self.path))}" else []
        )
        return ": ".join([*where, self.text])


def scenario_error(problems: Iterable[Problem]) -> ScenarioError:
    """The error that lists these problems by place; exit code 5 if plugins are all that is missing."""
    ordered = sorted(dict.fromkeys(problems), key=lambda problem: (problem.mark, dotted(problem.path)))
    codes = {problem.exit_code for problem in ordered}
    code = ExitCode.PLUGIN if codes == {ExitCode.PLUGIN} else ExitCode.USAGE
    return ScenarioError([(problem.message, problem.hint) for problem in ordered], code)


def check(
    model: type[Model], node: Node, path: Path = (), core: Sequence[str] = ()
) -> tuple[Model | None, list[Problem]]:
    """Validate a mapping against a pydantic model.

    Types are strict: ``"40"`` and ``true`` are no numbers, but a whole float such as ``1e4`` is an integer.

    Args:
        model: The model.
        node: The mapping.
        path: Keys that lead to it.
        core: Keys of the mapping that the core reads itself and the model does not see.

    Returns:
        The instance, or None, and the problems.
    """
    data = {key: _whole(value) for key, value in node.plain().items() if key not in core}
    try:
        return model.model_validate_json(json.dumps(data), strict=True), []
    except ValidationError as error:
        return None, _explain(error, model, node, path, core)
    except Exception as error:  # a validator of the plugin failed itself: its fault, not the scenario's
        text = f"the plugin's own check failed: {type(error).__name__}: {' '.join(str(error).split())}"
        return None, [Problem(node.name_mark, path, text, None, ExitCode.PLUGIN)]


def _whole(value: Any) -> Any:
    """The data with whole floats as integers, which strict validation takes for floats as well."""
    if isinstance(value, dict):
        return {key: _whole(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_whole(item) for item in value]
    if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
        return value if value == 0 and math.copysign(1, value) < 0 else int(value)
    return value


def _explain(
    error: ValidationError, model: type[BaseModel], root: Node, path: Path, core: Sequence[str]
) -> list[Problem]:
    """The problems of a validation; the alternatives of a union that all failed become one problem."""
    groups: dict[Path, list[Any]] = {}
    for details in error.errors(include_url=False, include_context=True, include_input=False):
        groups.setdefault(_inside(root, details["loc"], details["type"]), []).append(details)
    problems = []
    for loc, found in groups.items():
        node = _nearest(root, loc)
        text, hint = _words(found, model, node, loc, core)
        missing = found[0]["type"] in ("extra_forbidden", "missing") or found[0]["loc"][-1:] == ("[key]",)
        mark = node.name_mark if missing else node.mark
        problems.append(Problem(mark, (*path, *loc), text, hint))
    return problems


def _inside(root: Node, loc: tuple[str | int, ...], kind: str) -> Path:
    """The part of pydantic's location that is a path in the file: no names of union members."""
    node, path = root, []
    for place, step in enumerate(loc):
        child = node.child(step)
        if child is not None:
            node = child
            path.append(step)
        elif kind == "missing" and place == len(loc) - 1:
            path.append(step)
    return tuple(path)


def _nearest(root: Node, path: Path) -> Node:
    node = root
    for step in path:
        node = node.child(step) or node
    return node


def _words(
    found: list[Any], model: type[BaseModel], node: Node, loc: Path, core: Sequence[str]
) -> tuple[str, str | None]:
    """What is wrong with a value, and a hint."""
    first = found[0]
    about = _about(model, loc)
    if first["type"] == "with_hint":
        return first["msg"], first["ctx"]["hint"] or about
    if first["type"] == "missing":
        return "required, but missing", about
    if first["type"] == "extra_forbidden":
        known = [*names_at(model, loc[:-1]), *(core if len(loc) == 1 else ())]
        return "unknown key", did_you_mean(str(loc[-1]), known)
    expected = [_EXPECTED[details["type"]] for details in found if details["type"] in _EXPECTED]
    if expected and len(expected) == len(found):
        kinds = " or ".join(dict.fromkeys(expected))
        return f"should be {kinds}, found {describe(node)}", _yes_no(node, first["type"]) or about
    if first["type"] in ("literal_error", "enum"):
        choices = re.findall(r"'([^']*)'", first["ctx"]["expected"])
        text = f"should be {first['ctx']['expected']}, found {describe(node)}"
        near = _respelt(str(node.value), choices) or did_you_mean(str(node.value), choices)
        return text, near if near and near.startswith("did") else about
    if first["type"] == "union_tag_invalid":
        context = first["ctx"]
        tags = re.findall(r"'([^']*)'", context["expected_tags"])
        hint = _respelt(context["tag"], tags) or did_you_mean(context["tag"], tags)
        key = context["discriminator"].strip("'")
        return f"{key} should be one of {', '.join(tags)}, found {context['tag']!r}", hint or about
    return _message(first["msg"], node), about


def _respelt(word: str, choices: list[str]) -> str | None:
    """For a word that differs in capitals alone."""
    return next((f"did you mean {one!r}?" for one in choices if one.casefold() == word.casefold()), None)


def _message(message: str, node: Node) -> str:
    """Pydantic's own words, in one line and our style."""
    text = " ".join(message.split())
    text = re.sub(r"^(Value error|Assertion failed), ", "", text).replace("Input should", "should")
    text = re.sub(
        r"^(\w+) should have (at (?:least|most) \d+ \w+) after validation, not (\w+)", _COUNTED, text
    )
    text = text[:1].lower() + text[1:] if text[1:2].islower() else text
    told = re.search(rf"(?<![\w.]){re.escape(describe(node))}(?![\w.])", text)
    shown = isinstance(node.value, (dict, list)) or told is not None
    return text if shown else f"{text}, found {describe(node)}"


def _about(model: type[BaseModel], loc: Path) -> str | None:
    """``key: what it is [unit]``, from the description of the option."""
    info = field_at(model, loc)
    return f"{loc[-1]}: {' '.join(info.description.split())}" if info and info.description else None


def _yes_no(node: Node, kind: str) -> str | None:
    words = ("yes", "no", "on", "off")
    return "write true or false" if kind == "bool_type" and str(node.value).lower() in words else None


def describe(node: Node) -> str:
    """A value in words, short and on one line."""
    value = node.value
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a mapping" if value else "an empty mapping"
    if isinstance(value, list):
        return "a list" if value else "an empty list"
    text = repr(value)
    if isinstance(value, str):
        return f"the string {text}" if len(text) <= 60 else f"the string {text[:50]}...'"
    return text if len(text) <= 60 else f"{text[:50]}..."
