"""Options of components: their base class, and marks of numbers that may be drawn, of files and of code.

A simulator that draws the option ``x`` writes ``x: Drawable = Field(...)`` in its model. The model itself
only ever sees numbers: drawn values reach the simulator's ``reset_drawn`` (``avrare.stack.drawn_start``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_args

from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema


class Options(BaseModel):
    """Options of a component, or a block within them: frozen, without unknown keys or infinite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def used_files(self) -> Mapping[str, Path]:
        """Return files that no mark names, such as those within arguments, by option. Default: none."""
        return {}

    def used_models(self) -> Mapping[str, Path]:
        """Return model files of the distribution that these options name, by option. Default: none."""
        return {}

    def used_versions(self) -> Mapping[str, str]:
        """Return versions of distributions whose components these options choose. Default: none."""
        return {}


FILE = "file"
"""Key in ``Field(..., json_schema_extra={"file": True})`` of an option whose value may be a file's path."""
CODE = "code"
"""Key in ``Field(..., json_schema_extra={"code": True})`` of an option that names a module or its object."""


@dataclass(frozen=True)
class DrawableMark:
    """Mark of one option, and its part of the JSON schema: a number, or a mapping with a law."""

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return the schema of the number or of a law."""
        from avrare.base.laws import Law  # needs NumPy, which a list of plugins does without

        models: tuple[type[BaseModel], ...] = get_args(get_args(Law)[0])
        names = [name for model in models for name in get_args(model.model_fields["law"].annotation)]
        law = {
            "type": "object",
            "required": ["law"],
            "properties": {"law": {"enum": names}},
            "description": "law of a number that is drawn at the start of every rollout",
        }
        return {"anyOf": [handler(core), law]}


Drawable: TypeAlias = Annotated[float, DrawableMark()]
"""Number that a scenario may draw."""


def is_marked(field: FieldInfo, mark: str) -> bool:
    """Return whether an option is marked with ``json_schema_extra={mark: True}``."""
    extra = field.json_schema_extra
    return isinstance(extra, dict) and bool(extra.get(mark))
