"""Validation of options against pydantic models: every mistake at once, with its place and a hint."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from avrare.base.errors import ExitCode, ScenarioError, UsageError, did_you_mean
from avrare.plugin.options import DrawableMark, is_marked
from avrare.scenario.value_positions import Mark, Node, Path, Scalar, join_path

Value = TypeVar("Value")

UNKNOWN_KEY = "unknown key"

_TYPES = {
    "a list": "frozen_set_type list_type set_type tuple_type",
    "a mapping": "dataclass_type dict_type model_attributes_type model_type",
    "a number": "float_parsing float_type",
    "a string": "string_type",
    "a whole number": "int_from_float int_parsing int_type",
    "null": "none_required",
    "true or false": "bool_parsing bool_type",
}
_TYPE_NAMES = {kind: name for name, kinds in _TYPES.items() for kind in kinds.split()}
"""Pydantic's error type -> the type that was expected."""


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
        path = join_path(self.path)
        in_override = self.mark.file == f"--set {'.'.join(map(str, self.path))}"
        return ": ".join([str(self.mark), *([path] if path and not in_override else []), self.text])


def scenario_error(mistakes: Iterable[Mistake]) -> ScenarioError:
    """Return the error that lists these mistakes by place; exit code 5 if all of them are about plugins."""
    ordered = sorted(dict.fromkeys(mistakes), key=lambda mistake: (mistake.mark, join_path(mistake.path)))
    only_plugins = {mistake.exit_code for mistake in ordered} == {ExitCode.PLUGIN}
    code = ExitCode.PLUGIN if only_plugins else ExitCode.USAGE
    return ScenarioError([(mistake.message, mistake.hint) for mistake in ordered], code)


def error_with_hint(message: str, hint: str | None) -> PydanticCustomError:
    """Return an error of a model's validator that carries a hint."""
    return PydanticCustomError("with_hint", "{message}", {"message": message, "hint": hint})


def check(
    model: type[Value],
    node: Node,
    path: Path = (),
    other_keys: Sequence[str] = (),
    context: Sequence[str] | None = None,
    numbers: Mapping[Path, float] | None = None,
) -> tuple[Value | None, list[Mistake]]:
    """Validate options against a pydantic model or another type; return the value, or None, and the mistakes.

    Types are strict: ``"40"`` and ``true`` are not numbers, but a whole float such as ``1e4`` is an integer.

    Args:
        model: Type of the value.
        node: Options as written.
        path: Keys that lead to them in the file.
        other_keys: Keys that the core reads itself and the model does not see.
        context: Names for the validators of the model.
        numbers: Numbers in place of the values at some places, for instance of laws.
    """
    numbers = numbers or {}
    data = _as_data(node, numbers)
    if isinstance(data, dict):
        data = {key: value for key, value in data.items() if key not in other_keys}
    try:
        return TypeAdapter(model).validate_json(json.dumps(data), strict=True, context=context), []
    except ValidationError as error:
        places = find_places(model, node)
        for at, number in numbers.items():
            places[at] = replace(places[at], node=replace(places[at].node, value=number))
        return None, _explain(error, places, path, other_keys)
    except Exception as error:  # a validator of the plugin failed itself
        return None, [failed_check(error, node, path)]


def _as_data(node: Node, numbers: Mapping[Path, float], path: Path = ()) -> object:
    """Return plain data with integers for whole floats, since strict validation accepts both as floats."""
    value = numbers.get(path, node.value)
    if isinstance(value, dict):
        return {key: _as_data(entry, numbers, (*path, key)) for key, entry in value.items()}
    if isinstance(value, list):
        return [_as_data(element, numbers, (*path, index)) for index, element in enumerate(value)]
    if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
        return value if value == 0 and math.copysign(1, value) < 0 else int(value)
    return value


def failed_check(error: BaseException, node: Node, path: Path) -> Mistake:
    """Return the mistake of a plugin whose check raised an error."""
    text = f"the plugin's own check failed: {type(error).__name__}: {' '.join(str(error).split())}"
    return Mistake(node.name_mark, path, text, None, ExitCode.PLUGIN)


def check_options(
    model: type[object],
    name: str,
    options: Mapping[str, object],
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
        mistakes = _explain(error, find_places(model, Node.of(dict(options), Mark(""))), (), other_keys)
    texts = []
    for mistake in mistakes:
        option, component = join_path(mistake.path), f"{kind} {name!r}"
        if mistake.text == UNKNOWN_KEY:
            texts.append(f"unknown option {option!r} of {component}")
        else:
            texts.append(f"{f'option {option!r} of ' if option else ''}{component}: {mistake.text}")
    hints = [mistake.hint for mistake in mistakes if mistake.hint]
    raise UsageError("; ".join(texts), "; ".join(hints) or None)


@dataclass(frozen=True)
class Place:
    """Place in options, and its description by their model.

    Attributes:
        node: Value that is written there.
        fields: Fields of the model that the value may belong to.
        types: Types that the value may have, and their annotations.
    """

    node: Node
    fields: tuple[FieldInfo, ...]
    types: tuple[object, ...]

    @property
    def has_law(self) -> bool:
        """True where a number that may be drawn is given as a law."""
        return self.is_drawable and "law" in self.node.entries

    @property
    def is_drawable(self) -> bool:
        """True where the value is a number that may be drawn."""
        return any(isinstance(kind, DrawableMark) for kind in self.types)

    def is_marked(self, mark: str) -> bool:
        """Return whether the option has a mark of ``avrare.plugin.options``."""
        return any(is_marked(field, mark) for field in self.fields)

    @property
    def discriminator(self) -> str | None:
        """Key whose value chooses one of the models."""
        keys = [kind.discriminator for kind in self.types if isinstance(kind, FieldInfo)]
        return next((key for key in keys if isinstance(key, str)), None)

    @property
    def tag(self) -> Scalar:
        """Value of that key."""
        node = self.node.child(self.discriminator) if self.discriminator is not None else None
        return node.value if node is not None and isinstance(node.value, str) else None

    @property
    def models(self) -> list[type[BaseModel]]:
        """Models that may read the value; those of its tag where it has one."""
        models = [kind for kind in self.types if isinstance(kind, type) and issubclass(kind, BaseModel)]
        return [model for model in models if self.tag in _tags(model, self.discriminator)] or models

    def find_fields(self, key: str | int) -> list[FieldInfo]:
        """Return the fields of the models that the entry ``key`` may belong to."""
        return [field for model in self.models for name, field in _fields(model) if name == key]


def find_places(model: object, node: Node) -> dict[Path, Place]:
    """Walk over options and their model together and return every place, those of the options first.

    A law in the place of a number is a single place.
    """
    return dict(_walk((), Place(node, (), tuple(_alternatives(model)))))


def _walk(path: Path, place: Place) -> Iterator[tuple[Path, Place]]:
    yield path, place
    for step, child in place.node.children if not place.has_law else ():
        fields = place.find_fields(step)
        kinds = [alternative for field in fields for alternative in _alternatives(field)]
        if not fields:  # an entry of a mapping or a list
            fields = list(place.fields) if any(get_origin(kind) is dict for kind in place.types) else []
            entries = [entry for kind in place.types for entry in get_args(kind)]
            kinds = [alternative for entry in entries for alternative in _alternatives(entry)]
        yield from _walk((*path, step), Place(child, tuple(fields), tuple(kinds)))


def _alternatives(kind: object) -> Iterator[object]:
    """Yield the members of a union and the annotations of a type, or the type itself."""
    if isinstance(kind, FieldInfo):
        yield from (kind, *kind.metadata, *_alternatives(kind.annotation))
    elif get_origin(kind) in (Annotated, Union, UnionType):
        for member in get_args(kind):
            yield from _alternatives(member)
    else:
        yield kind


def _tags(model: type[BaseModel], key: str | None) -> tuple[Scalar, ...]:
    field = model.model_fields.get(key) if key is not None else None
    return get_args(field.annotation) if field is not None else ()


def _fields(model: type[BaseModel]) -> Iterator[tuple[str, FieldInfo]]:
    for name, field in model.model_fields.items():
        yield field.alias or name, field


def _explain(
    error: ValidationError, places: Mapping[Path, Place], path: Path, other_keys: Sequence[str]
) -> list[Mistake]:
    # Failed alternatives of one union become one mistake.
    groups: dict[Path, list[ErrorDetails]] = {}
    for details in error.errors(include_url=False, include_input=False):
        groups.setdefault(_find_path(details, places), []).append(details)
    mistakes = []
    for at, errors in groups.items():
        first = errors[0]
        inside = any(other != at and other[: len(at)] == at for other in groups)
        if first["type"] == "too_short" and inside:
            continue  # pydantic counts only the items without mistakes
        node = places.get(at, places[at[:-1]]).node  # that of the mapping where a key is missing
        key_errors = ("extra_forbidden", "missing", "union_tag_not_found")
        about_key = first["type"] in key_errors or first["loc"][-1:] == ("[key]",)
        text, hint = _describe_error(errors, places, at, other_keys)
        mistakes.append(Mistake(node.name_mark if about_key else node.mark, (*path, *at), text, hint))
    return mistakes


def _find_path(details: ErrorDetails, places: Mapping[Path, Place]) -> Path:
    """Return the part of pydantic's location that is written, without names of the members of a union."""
    location, absent = details["loc"], details["type"] == "missing"
    path: Path = ()
    tagged: Path | None = None
    for step in location[:-1] if absent else location:
        if step == places[path].tag and path != tagged:
            tagged = path
        elif (*path, step) in places:
            path = (*path, step)
    if details["type"] in ("union_tag_invalid", "union_tag_not_found"):
        return (*path, details["ctx"]["discriminator"].strip("'"))
    return (*path, location[-1]) if absent else path


def _describe_error(
    errors: Sequence[ErrorDetails], places: Mapping[Path, Place], path: Path, other_keys: Sequence[str]
) -> tuple[str, str | None]:
    """Return message and hint for the errors of one place."""
    first, context = errors[0], errors[0].get("ctx", {})
    above = places[path[:-1]]
    place = places.get(path, above)
    fields = place.fields if path in places else above.find_fields(path[-1])
    description = fields[0].description if fields else None
    help_text = f"{path[-1]}: {' '.join(description.split())}" if description else None
    types = list(dict.fromkeys(_TYPE_NAMES.get(error["type"], "") for error in errors))
    match first["type"]:
        case "with_hint":
            return first["msg"], context["hint"] or help_text
        case "missing":
            return "required, but missing", help_text
        case "union_tag_not_found":
            tags = [str(tag) for model in above.models for tag in _tags(model, above.discriminator)]
            return "required, but missing", did_you_mean("", tags)
        case "extra_forbidden":
            names = [name for model in above.models for name, _ in _fields(model)]
            hint = did_you_mean(str(path[-1]), [*names, *(other_keys if len(path) == 1 else ())])
            same_key = [join_path(at) for at in places if at != path and at[-1:] == path[-1:]]
            return UNKNOWN_KEY, hint or (did_you_mean("", same_key) if same_key else None)
        case "literal_error" | "enum":
            text = f"should be {context['expected']}, found {describe(place.node)}"
            near = _suggest(str(place.node.value), context["expected"])
            return text, near if near and near.startswith("did") else help_text
        case "union_tag_invalid":
            choices = context["expected_tags"]
            text = f"should be one of {', '.join(_quote(choices))}, found {describe(place.node)}"
            return text, _suggest(context["tag"], choices) or help_text
    if "" in types:
        return _reword(first["msg"], place.node), help_text
    if "law" in place.node.entries and not place.is_drawable and "number" in " ".join(types):
        drawable = [join_path(at) for at, other in places.items() if other.is_drawable]
        hint = f"of the options given here these can: {', '.join(drawable)}" if drawable else help_text
        return "this option cannot be drawn: it should be a number", hint
    yes_no = types[0] == "true or false" and str(place.node.value).lower() in ("yes", "no", "on", "off")
    text = f"should be {' or '.join(types)}, found {describe(place.node)}"
    if types == ["a mapping"] and len(place.models) == 1:
        keys = ", ".join(name for name, _ in _fields(place.models[0]))
        help_text = f"{help_text or path[-1]}, with the keys {keys}"
    return text, "write true or false" if yes_no else help_text


def _quote(expected: str) -> list[str]:
    return re.findall(r"'([^']*)'", expected)


def _suggest(word: str, expected: str) -> str | None:
    """Return a hint with the choice that ``word`` resembles; one that differs in case only comes first."""
    choices = _quote(expected)
    same = [choice for choice in choices if choice.casefold() == word.casefold()]
    return f"did you mean {same[0]!r}?" if same else did_you_mean(word, choices)


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
