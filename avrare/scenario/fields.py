"""The fields of a pydantic model along a path, through lists, mappings and unions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from avrare.scenario.source import Path


def names_at(model: type[BaseModel], path: Path) -> list[str]:
    """The keys that the mapping at ``path`` may have; empty where any key may stand."""
    return [name for part in _models_at(model, path) for name, _ in _fields(part)]


def field_at(model: type[BaseModel], path: Path) -> FieldInfo | None:
    """The field at ``path``; the list itself for an item of a list; None if there is none."""
    if not path:
        return None
    for part in _models_at(model, path[:-1]):
        for name, info in _fields(part):
            if name == path[-1]:
                return info
    return None


def _models_at(model: type[BaseModel], path: Path) -> list[type[BaseModel]]:
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
    """Every model that an annotation mentions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)
