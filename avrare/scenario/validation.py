"""Validation of options against pydantic models: every mistake at once, with its place and a hint."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from avrare.base.errors import ExitCode, ScenarioError, UsageError, did_you_mean
from avrare.scenario.value_positions import Mark, Node, Path, dotted

UNKNOWN_KEY = "unknown key"

_TYPES = {
    "a list": "frozen_set_type list_type set_type tuple_type",
    "a mapping": "dataclass_type dict_type model_type",
    "a number": "float_parsing float_type",
    "a string": "string_type",
    "a whole number": "int_from_float int_parsing int_type",
    "null": "none_required",
    "true or false": "bool_parsing bool_type",
}
_TYPE_NAMES = {kind: name for name, kinds in _TYPES.items() for kind in kinds.split()}
"""Pydantic's error type -> the type that was expected."""


class Translation(NamedTuple):
    """Error of a validation: keys that lead to the value, message, hint, and a flag for bad keys."""

    path: Path
    text: str
    hint: str | None
    about_key: bool


def _translate(
    error: ValidationError, model: type[BaseModel], data: Node, other_keys: Sequence[str] = ()
) -> list[Translation]:
    # Failed alternatives of one union become one error.
    groups: dict[Path, list[Any]] = {}
    for details in error.errors(include_url=False, include_context=True, include_input=False):
        groups.setdefault(_path_in(data, details["loc"], details["type"]), []).append(details)
    translations = []
    for path, found in groups.items():
        inside = any(other != path and other[: len(path)] == path for other in groups)
        if found[0]["type"] == "too_short" and inside:
            continue  # pydantic counts only the items without mistakes
        text, hint = _explain(found, model, _nearest(data, path), path, other_keys)
        about_key = found[0]["type"] in ("extra_forbidden", "missing") or found[0]["loc"][-1:] == ("[key]",)
        translations.append(Translation(path, text, hint, about_key))
    return translations


def _nearest(data: Node, path: Path) -> Node:
    for step in path:
        data = data.child(step) or data
    return data


def describe(node: Node) -> str:
    """Return a value as a few words on one line."""
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


def _path_in(data: Node, location: tuple[str | int, ...], kind: str) -> Path:
    """Return the part of pydantic's location that exists in the data, without names of union members."""
    node, path = data, []
    for place, step in enumerate(location):
        child = node.child(step)
        if child is not None:
            node = child
            path.append(step)
        elif kind == "missing" and place == len(location) - 1:
            path.append(step)
    return tuple(path)


def _explain(
    found: list[Any], model: type[BaseModel], node: Node, path: Path, other_keys: Sequence[str]
) -> tuple[str, str | None]:
    first = found[0]
    kind, context = first["type"], first.get("ctx", {})
    option = _option_help(model, path)
    if kind == "with_hint":
        return first["msg"], context["hint"] or option
    if kind == "missing":
        return "required, but missing", option
    if kind == "extra_forbidden":
        known = [*_keys_at(model, path[:-1]), *(other_keys if len(path) == 1 else ())]
        return UNKNOWN_KEY, did_you_mean(str(path[-1]), known)
    types = [_TYPE_NAMES[details["type"]] for details in found if details["type"] in _TYPE_NAMES]
    if len(types) == len(found):
        yes_no = types[0] == "true or false" and str(node.value).lower() in ("yes", "no", "on", "off")
        hint = "write true or false" if yes_no else option
        return f"should be {' or '.join(dict.fromkeys(types))}, found {describe(node)}", hint
    if kind in ("literal_error", "enum"):
        text = f"should be {context['expected']}, found {describe(node)}"
        near = _suggest(str(node.value), context["expected"])
        return text, near if near and near.startswith("did") else option
    if kind == "union_tag_invalid":
        key, tags = context["discriminator"].strip("'"), re.findall(r"'([^']*)'", context["expected_tags"])
        text = f"{key} should be one of {', '.join(tags)}, found {context['tag']!r}"
        return text, _suggest(context["tag"], context["expected_tags"]) or option
    return _reword(first["msg"], node), option


def _suggest(word: str, expected: str) -> str | None:
    """Return a hint with the choice that ``word`` resembles; one that differs in case only comes first."""
    choices = re.findall(r"'([^']*)'", expected)
    same = next((f"did you mean {one!r}?" for one in choices if one.casefold() == word.casefold()), None)
    return same or did_you_mean(word, choices)


def _reword(message: str, node: Node) -> str:
    text = " ".join(message.split())
    text = re.sub(r"^(Value error|Assertion failed), ", "", text).replace("Input should", "should")
    # "Dictionary should have at least 1 item after validation, not 0": the type is pydantic's business.
    text = re.sub(
        r"^\w+ should have (at (?:least|most) \d+ \w+) after validation, not (\w+)",
        r"should have \1, found \2",
        text,
    )
    text = text[:1].lower() + text[1:] if text[1:2].islower() else text
    quoted = re.search(rf"(?<![\w.]){re.escape(describe(node))}(?![\w.])", text)
    if isinstance(node.value, (dict, list)) or quoted:
        return text
    return f"{text}, found {describe(node)}"


def fields_at(model: type[BaseModel], path: Path) -> list[FieldInfo]:
    """Return the fields that the value at ``path`` may belong to, through lists, mappings and unions.

    A number in a mapping of numbers belongs to the mapping's own field.
    """
    parts = _models_at(model, path[:-1])
    found = [info for part in parts for name, info in _fields(part) if path[-1:] == (name,)]
    if found or len(path) < 2:
        return found
    return [info for info in fields_at(model, path[:-1]) if get_origin(info.annotation) is dict]


def _option_help(model: type[BaseModel], path: Path) -> str | None:
    info = next(iter(fields_at(model, path)), None)
    return f"{path[-1]}: {' '.join(info.description.split())}" if info and info.description else None


def _keys_at(model: type[BaseModel], path: Path) -> list[str]:
    return [name for part in _models_at(model, path) for name, _ in _fields(part)]


def _models_at(model: type[BaseModel], path: Path) -> list[type[BaseModel]]:
    """Return the models that the value at ``path`` may have, through lists, mappings and unions."""
    found = [model]
    for step in path:
        infos = [info for part in found for name, info in _fields(part) if name == step]
        if infos:
            found = [part for info in infos for part in _models_in(info.annotation)]
    return found


def _fields(model: type[BaseModel]) -> Iterator[tuple[str, FieldInfo]]:
    for name, info in model.model_fields.items():
        yield info.alias or name, info


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class Mistake:
    """Error at a place in a scenario: keys that lead to it, message and advice.

    The exit code is ``ExitCode.PLUGIN`` for a missing or broken plugin.
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
        in_override = self.mark.file == f"--set {'.'.join(map(str, self.path))}"
        return ": ".join([str(self.mark), *([path] if path and not in_override else []), self.text])


def scenario_error(mistakes: Iterable[Mistake]) -> ScenarioError:
    """Return the error that lists these mistakes by place; exit code 5 if all of them are about plugins."""
    ordered = sorted(dict.fromkeys(mistakes), key=lambda mistake: (mistake.mark, dotted(mistake.path)))
    only_plugins = {mistake.exit_code for mistake in ordered} == {ExitCode.PLUGIN}
    code = ExitCode.PLUGIN if only_plugins else ExitCode.USAGE
    return ScenarioError([(mistake.message, mistake.hint) for mistake in ordered], code)


def check(
    model: type[Model], node: Node, path: Path = (), other_keys: Sequence[str] = ()
) -> tuple[Model | None, list[Mistake]]:
    """Validate a mapping against a pydantic model.

    Types are strict: ``"40"`` and ``true`` are not numbers, but a whole float such as ``1e4`` is an integer.
    The model does not see ``other_keys``, which the core reads itself. Returns the instance, or None, and the
    mistakes.
    """
    data = {key: _with_integers(value) for key, value in node.plain().items() if key not in other_keys}
    try:
        return model.model_validate_json(json.dumps(data), strict=True), []
    except ValidationError as error:
        mistakes = []
        for at, text, hint, about_key in _translate(error, model, node, other_keys):
            place = _nearest(node, at)
            mistakes.append(Mistake(place.name_mark if about_key else place.mark, (*path, *at), text, hint))
        return None, mistakes
    except Exception as error:  # a validator of the plugin failed itself
        return None, [failed_check(error, node, path)]


def failed_check(error: BaseException, node: Node, path: Path) -> Mistake:
    """Return the mistake of a plugin whose own check raised an error."""
    text = f"the plugin's own check failed: {type(error).__name__}: {' '.join(str(error).split())}"
    return Mistake(node.name_mark, path, text, None, ExitCode.PLUGIN)


def check_options(
    model: type[Any],
    name: str,
    options: Mapping[str, Any],
    kind: str = "estimator",
    other_keys: Sequence[str] = (),
) -> Any:
    """Return the instance of a pydantic model for options given in Python, objects of any type.

    The ``UsageError`` names all unknown and invalid options of the component ``name``, and suggests
    ``other_keys`` as well for a misspelt one.
    """
    try:
        return model(**options)
    except ValidationError as error:
        found = _translate(error, model, Node.of(dict(options), Mark("")), other_keys)
    texts = []
    for path, text, _, _ in found:
        option, component = dotted(path), f"{kind} {name!r}"
        if text == UNKNOWN_KEY:
            texts.append(f"unknown option {option!r} of {component}")
        else:
            texts.append(f"option {option!r} of {component}: {text}" if path else f"{component}: {text}")
    raise UsageError("; ".join(texts), "; ".join(hint for _, _, hint, _ in found if hint) or None)


def _with_integers(value: Any) -> Any:
    """Replace whole floats by integers, which strict validation accepts for floats as well."""
    if isinstance(value, dict):
        return {key: _with_integers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_integers(item) for item in value]
    if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
        return value if value == 0 and math.copysign(1, value) < 0 else int(value)
    return value
